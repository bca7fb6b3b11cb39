"""Trial with a season of nightly runs on one machine whose errors drift and that has one collision."""
