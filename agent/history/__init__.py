"""History of the runs of all machines, with trends and alarms. It is derived from the journals, which remain the
authoritative record.
"""
