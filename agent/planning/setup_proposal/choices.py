"""Words from which a person chooses when a new machine is stated. They stand apart from the mathematics that they
choose, so that `volcal init --help` can show them without importing it."""

from __future__ import annotations

from typing import Final

MACHINE_CLASS_NAMES = ("mill", "router", "portal", "large-ram")
SHAPES = ("tilted-bar", "straight-bar", "ball-plate", "tetrahedron")
CALIBRATIONS = ("certificate", "length", "none")
SIGNS: Final = {"+": 1, "-": -1}
SPINDLES = tuple(f"{sign}{axis}" for axis in "XYZ" for sign in SIGNS)
"""All spindle directions: the direction from the spindle to the stylus."""
