"""Kinds of run (calibration, verification, night, restoration), with their measurements, judgement and decisions."""
