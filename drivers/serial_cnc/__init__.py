"""CNC behind a serial line: GRBL 1.1 and grblHAL; parameters and tables in tape format (`tape`)."""
