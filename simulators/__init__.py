"""The simulated machine: world physics moved by a clock, and wire servers that know bytes only."""
