"""Kinds of run: calibration, verification, night and restoration; their measurements, judgement and decisions."""
