"""Trial with a season of nightly runs on one machine that drifts and that has one collision."""
