"""A simulated fortnight: the real service, a timer, a machine that ages, and everything that goes wrong on the way."""
