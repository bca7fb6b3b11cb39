"""Plans as generators of frozen steps: no hardware, no clock, no randomness, no I/O."""
