"""Collision bodies, volumes swept by moving bodies, and collision-free paths of the probe."""
