"""Simulated fortnight: the real service, a timer, a machine that ages, and all kinds of incidents."""
