"""A season of nights on a machine that drifts and is hit once."""
