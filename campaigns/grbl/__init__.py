"""Trial of a whole calibration over a serial line with a simulated GRBL or grblHAL, disturbed at random instants."""
