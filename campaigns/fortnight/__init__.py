"""Simulated fortnight of the real service, with a timer, a machine that ages, and many kinds of incidents."""
