"""Driver for a CNC with GRBL 1.1 or grblHAL on a serial line.

Package `tape` transfers parameters and tables in tape format.
"""
