"""Error model of a machine with three linear axes, and computation of its tool point deviation (forward model)."""
