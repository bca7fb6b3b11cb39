"""Kinds of run: calibration, verification, night and restoration. Each kind has its own measurements and decisions."""
