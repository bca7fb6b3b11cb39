"""Calibrations during which machine and ball bar warm up."""
