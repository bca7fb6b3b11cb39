"""Simulated machine: a world with physics whose time a clock advances, and protocol servers that give access to the
world.

The protocol servers exchange only bytes with their clients. Terms are defined in docs/reference/glossary.md.
"""

SIMULATE_HELP = "Run the simulated machine on real links until it is stopped."
"""Help line of `volcal simulate`. It is defined here because the list of commands imports only this package."""
