"""CNC with GRBL 1.1 or grblHAL on a serial line, and transfer of parameters and tables in tape format (`tape`)."""
