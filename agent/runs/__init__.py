"""Runs on a machine: start, execution, resumption and abandonment. Also contains the identification from files."""
