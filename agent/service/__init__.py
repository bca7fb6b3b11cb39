"""Calibration service: the one owner of the machine and the endpoints for people, panels and other programs."""
