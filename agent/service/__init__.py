"""Calibration service: the single owner of the machine, and the endpoints for people, panels and other programs."""
