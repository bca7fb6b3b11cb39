"""Simulated GRBL 1.1 controller on a pseudo-terminal."""
