"""History of the runs of all machines, with trends and alarms.

The history is derived from the journals, which remain the authoritative record.
"""
