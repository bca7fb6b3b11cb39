"""Error model and forward model of a machine with three linear axes."""
