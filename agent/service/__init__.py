"""Calibration service. It consists of the owner of the machine, which alone uses the machine, and of the endpoints for
people, panels and other programs."""
