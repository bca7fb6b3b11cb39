"""Simulated machine: world physics advanced by a clock, and wire servers that handle only bytes."""

SIMULATE_HELP = "Run the simulated machine on real links until it is stopped."
"""Help line of `volcal simulate`, here because the list of commands imports this package only."""
