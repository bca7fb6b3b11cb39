"""Readings of other instruments (laser, straightness optics, ballbar, level, earlier report) as rows of an estimate."""
