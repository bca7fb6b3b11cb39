"""Resumption and abandonment of an interrupted run."""
