"""Bodies, swept volumes and collision-free paths of the probe."""
