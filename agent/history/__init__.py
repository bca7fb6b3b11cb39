"""History of the calibration runs of all machines, with the trends of their results and alarms of these trends.

The history is derived from the journals, the databases in which each machine records its runs. The journals remain the
authoritative record.
"""
