"""Numbers of homings from which a scatter is determined. This module imports nothing, because the help texts of the
commands state these numbers."""

FEWEST_HOMINGS = 3
"""Number of homings from which a standard deviation is stated; its upper 95 % limit is then six times its value."""

MOST_HOMINGS = 30
"""Largest number of homings that may be asked for. More tell little else."""
