"""Simulated machine: physics of a world that a clock advances, and protocol servers that handle only bytes."""

SIMULATE_HELP = "Run the simulated machine on real links until it is stopped."
"""Help line of `volcal simulate`. It is defined here because the list of commands imports only this package."""
