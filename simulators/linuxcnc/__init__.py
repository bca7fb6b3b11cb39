"""Simulated plant (machine, balls and mount) around a real LinuxCNC controller."""
