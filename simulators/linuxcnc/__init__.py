"""Simulated plant for a real LinuxCNC: machine, balls and mount of the simulated world around a real controller."""
