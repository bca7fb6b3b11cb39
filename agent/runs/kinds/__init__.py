"""Kinds of run beside the full calibration: what a night measures, how it is judged, what it decides."""
