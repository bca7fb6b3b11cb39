"""Season of nights on a machine that drifts and has one collision."""
