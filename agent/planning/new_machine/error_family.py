"""Proposed family of errors: half-widths of the error parameters of machines of one class and size.

The half-widths follow from reference tolerances, which are power laws in the length L of the axis. They are chosen to
be of the size that acceptance tests of machining centres allow, and they reproduce no table of a standard:

    mean positioning deviation     12 µm · (L / 800 mm)^0.5
    straightness                   15 µm · (L / 800 mm)^0.66
    pitch, yaw and roll            60 µrad, and at most 4 · straightness / L
    squareness                     40 µrad (20 µm in 500 mm)

A family whose amplitudes are `share` times the tolerances contains 95 % of the axes within `share` times the tolerance.
These are typical values, not knowledge of one machine: the identification doubts the family and states how well it
agrees with the measurements.
"""

from __future__ import annotations

from agent.planning.new_machine.machine_class import MachineClass

REFERENCE_LENGTH_MM = 800.0
POSITIONING_UM = 12.0
POSITIONING_EXPONENT = 0.5
STRAIGHTNESS_UM = 15.0
STRAIGHTNESS_EXPONENT = 0.66
ANGLE_URAD = 60.0
SQUARENESS_URAD = 40.0

ORDERS = 5
DECAY = 0.6
"""Factor from the half-width of one Legendre order to that of the next."""
RANGE_OF_SERIES = 2.23
"""95th percentile of the range of a Legendre series of the orders 1 to 5 with uniform coefficients, for a half-width of
1 at order 1 and the decay above (20,000 draws)."""
RANGE_OF_STRAIGHTNESS = 1.68
"""The same for the orders 2 to 5, relative to the line through the end points."""
SQUARENESS_WITHIN_TOLERANCE = 0.95
"""Share of a uniform distribution within 95 % of its half-width."""
CROSS_SHARE = 0.5
"""Cross effects of a ram, relative to the lowest order of straightness and rotation."""

Amplitudes = dict[str, float | list[float]]


def propose_family(kind: MachineClass, travel_mm: tuple[float, float, float]) -> Amplitudes:
    """Return the amplitudes of the section `[model.family]` of a machine file, for a machine of class `kind` with the
    given travels of X, Y and Z in mm.

    Amplitudes of displacements are computed for the longest axis. Amplitudes of rotations are computed for the axis of
    medium length, because a rotation acts through a lever along another axis.
    """
    _, medium, longest = sorted(travel_mm)
    share = kind.tolerance_share
    positioning = share * POSITIONING_UM * (longest / REFERENCE_LENGTH_MM) ** POSITIONING_EXPONENT / RANGE_OF_SERIES
    straightness = share * _straightness_um(longest) / RANGE_OF_STRAIGHTNESS
    angle = min(ANGLE_URAD, 4e3 * _straightness_um(medium) / medium)
    rotation = share * angle / RANGE_OF_SERIES
    cross = CROSS_SHARE if kind.cross_effect else 0.0
    return {
        "positioning_um": _series(positioning, ORDERS),
        "straightness_um": _series(straightness, ORDERS - 1),
        "rotation_urad": _series(rotation, ORDERS),
        "squareness_urad": round(share * SQUARENESS_URAD / SQUARENESS_WITHIN_TOLERANCE, 1),
        "cross_displacement_um": round(cross * straightness, 1),
        "cross_rotation_urad": round(cross * rotation, 1),
    }


def _straightness_um(length_mm: float) -> float:
    return float(STRAIGHTNESS_UM * (length_mm / REFERENCE_LENGTH_MM) ** STRAIGHTNESS_EXPONENT)


def _series(first: float, orders: int) -> list[float]:
    return [round(first * DECAY**order, 2) for order in range(orders)]
