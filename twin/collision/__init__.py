"""Collision bodies, swept volumes and collision-free paths of the probe."""
