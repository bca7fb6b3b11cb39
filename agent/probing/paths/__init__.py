"""Collision-free tip paths between touches, balls and positions."""
