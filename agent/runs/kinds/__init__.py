"""Kinds of run: calibration, verification, nightly run and restoration of a table. Each kind has its own measurements
and decisions."""
