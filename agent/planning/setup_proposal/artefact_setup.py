"""Ball bar for a machine: stated by a person, or proposed from the travel of the machine."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from agent.planning.setup_proposal.machine_setup import MachineSetup

LENGTHS_MM = (120, 150, 175, 200, 250, 300, 350, 400, 500, 600, 800, 1000, 1200, 1500)
"""Proposed lengths of a bar, between the centres of its end balls. The longest one can still be carried."""
FLAT_SHARE = 0.5
"""Length of the bar relative to the medium travel, for a machine whose shortest travel allows only flat elevations."""
DIAGONAL = math.sqrt(2.0)
TOUCHED_MM = 60.0
"""Part of a travel that is needed to touch the balls at the ends of the bar from both sides, in mm."""
STANDARD_UNCERTAINTY_UM = 0.8
"""Standard uncertainty of a coordinate in the certificate of a calibrated ball bar."""


@dataclass(frozen=True)
class BarSetup:
    """Straight bar with equally spaced balls on holders.

    `length_mm` is the distance between the centres of the end balls. The holders have the length `holder_mm` from the
    axis of the bar to the centre of a ball, and are tilted by `tilt_deg` alternately up, out, down and in.
    """

    length_mm: float
    balls: int
    tilt_deg: float
    holder_mm: float
    diameter_mm: float
    standard_uncertainty_um: float = STANDARD_UNCERTAINTY_UM
    origins: Mapping[str, str] = field(default_factory=dict)


def propose_bar(machine: MachineSetup) -> BarSetup:
    """Return a ball bar whose length fits the travel of the machine.

    At an elevation of 45° the bar must fit into the shortest travel and, along an axis, into the medium one. On a flat
    machine this would be too short for the long axes; there the bar is half the medium travel, and it is measured at
    smaller elevations.
    """
    shortest, medium, _ = sorted(machine.travel_mm)
    wanted = min(medium, max(DIAGONAL * (shortest - TOUCHED_MM), FLAT_SHARE * medium))
    return nominal_bar(max((size for size in LENGTHS_MM if size <= wanted), default=LENGTHS_MM[0]))


def shorter_bar(bar: BarSetup) -> BarSetup | None:
    """Return a bar of the next shorter proposed length, or None if there is none."""
    shorter = [size for size in LENGTHS_MM if size < bar.length_mm]
    return nominal_bar(max(shorter)) if shorter else None


def nominal_bar(length_mm: float) -> BarSetup:
    """Return a bar of the given length with the proposed balls and holders."""
    return BarSetup(
        length_mm=float(length_mm),
        balls=balls_of(length_mm),
        tilt_deg=tilt_of(length_mm),
        holder_mm=holder_of(length_mm),
        diameter_mm=diameter_of(length_mm),
    )


def balls_of(length_mm: float) -> int:
    """Return the proposed number of balls of a bar of the given length: an odd number, so that one is in the middle."""
    return 11 if length_mm >= 800.0 else 9 if length_mm >= 300.0 else 7


def tilt_of(length_mm: float) -> float:
    """Return the proposed tilt of the holders in degrees: none on a short bar, whose balls stand so close that the
    stylus would touch a tilted neighbour while the bar is inclined."""
    return 15.0 if length_mm >= 300.0 else 0.0


def holder_of(length_mm: float) -> float:
    """Return the proposed length of the holders in mm for a bar of the given length."""
    return 60.0 if length_mm >= 800.0 else 40.0 if length_mm >= 300.0 else 30.0


def diameter_of(length_mm: float) -> float:
    """Return the proposed ball diameter in mm for a bar of the given length."""
    return 25.0 if length_mm >= 800.0 else 20.0 if length_mm >= 300.0 else 12.0
