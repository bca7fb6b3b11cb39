"""Simulated plant (machine, balls and rotary mount) around a real LinuxCNC controller."""
