"""Finite elements: results of other programs made into deflection grids, and a solid model of a small machine."""
