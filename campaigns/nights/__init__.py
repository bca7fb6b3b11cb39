"""Season of nightly runs on one machine that drifts and has one collision."""
