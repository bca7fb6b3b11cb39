"""Plans: generators of frozen steps. No hardware, no clock, no randomness, no I/O."""
