"""Simulated machine: world physics advanced by a clock, and wire servers that handle only bytes."""
