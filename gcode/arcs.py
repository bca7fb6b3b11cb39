"""Circular and helical arcs (G2, G3) in the three main planes. An arc is given by its centre or by its radius."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gcode.words import Block
from twin.arrays import Array

Axes = tuple[int, int, int]

PLANE_AXES: dict[int, Axes] = {170: (0, 1, 2), 180: (2, 0, 1), 190: (1, 2, 0)}
"""First, second and normal axis of each plane; the key is ten times the G code.

The three axes are right-handed, so the plane of G18 is Z, X.
"""

CENTRE_LETTERS = "IJK"

_SAME_POINT_MM = 1e-6
_RADIUS_SURE_MM = 0.005  # these three limits as in Grbl 1.1 (its error 33)
_RADIUS_SHARE = 1e-3
_RADIUS_LARGEST_MM = 0.5
_NO_TURN_RAD = 5e-7  # a smaller angle means a full circle, also as in Grbl
_MOST_TURNS = 10_000


@dataclass(frozen=True, slots=True)
class Arc:
    """Circular or helical arc that one block (program line) commands.

    `axes` contains the numbers of the two axes of the arc's plane and of the axis normal to it. `centre` contains the
    coordinates of the centre in mm along the two axes of the plane. Angles are in rad. `angle` is the angle of the
    start point as seen from the centre. `sweep` is the signed angle from start to end, including full turns.

    Coordinates in programs are rounded, so the distances of start and end from the centre differ by about a µm. The
    radius therefore changes linearly from `radius` to `end_radius`.
    """

    axes: Axes
    centre: tuple[float, float]
    radius: float
    end_radius: float
    angle: float
    sweep: float


def read_arc(
    block: Block,
    start: Sequence[float],
    end: Sequence[float],
    *,
    clockwise: bool,
    axes: Axes,
    unit_mm: float,
    centre_origin: Sequence[float] | None,
) -> Arc:
    """Return the arc that a block (program line) with G2 or G3 in effect describes. `start` and `end` are axis
    positions in mm.

    If arc centres are absolute (G90.1), `centre_origin` is the axis position of the program's zero point. If they are
    relative to the start of the arc (G91.1), it is None. Raises FormatError if the block does not describe an arc.
    """
    a, b, normal = axes
    if CENTRE_LETTERS[normal] in block.values:
        block.refuse(f"{CENTRE_LETTERS[normal]} is not in the plane of the arc")
    if "R" in block.values:
        centre = _centre_by_radius(block, start, end, axes, clockwise, unit_mm)
    else:
        centre = _centre_by_offsets(block, start, axes, unit_mm, centre_origin)
    first = (start[a] - centre[0], start[b] - centre[1])
    last = (end[a] - centre[0], end[b] - centre[1])
    radius, end_radius = math.hypot(*first), math.hypot(*last)
    _check_radii(block, radius, end_radius)
    angle = math.atan2(first[1], first[0])
    # Angle from the first to the last radius: atan2 of their cross and dot products, within ±π.
    turn = math.atan2(first[0] * last[1] - first[1] * last[0], first[0] * last[0] + first[1] * last[1])
    sweep = _directed(turn, clockwise) + _more_turns(block, clockwise)
    return Arc(axes, centre, radius, end_radius, angle, sweep)


def arc_points(arcs: Sequence[Arc], which: np.ndarray, share: Array, starts: Array, ends: Array) -> Array:
    """Return n points on m arcs, as axis positions (n, 3) in mm.

    For each point, `which` (n,) contains the index of its arc, and `share` (n,) its position along this arc as a
    fraction from 0 (start) to 1 (end). `starts` and `ends` (m, 3) are the start and the end of each arc in mm. Only
    their component along the normal of the arc is used."""
    axes = np.array([arc.axes for arc in arcs])[which]
    a0, b0, radius, end_radius, angle, sweep = np.array(
        [(*arc.centre, arc.radius, arc.end_radius, arc.angle, arc.sweep) for arc in arcs]
    )[which].T
    rows = np.arange(len(which))
    turned = angle + share * sweep
    at_radius = radius + share * (end_radius - radius)
    points = np.empty((len(which), 3))
    points[rows, axes[:, 0]] = a0 + at_radius * np.cos(turned)
    points[rows, axes[:, 1]] = b0 + at_radius * np.sin(turned)
    first, last = starts[which, axes[:, 2]], ends[which, axes[:, 2]]
    points[rows, axes[:, 2]] = first + share * (last - first)
    return points


def _centre_by_offsets(
    block: Block, start: Sequence[float], axes: Axes, unit_mm: float, origin: Sequence[float] | None
) -> tuple[float, float]:
    letters = [CENTRE_LETTERS[axis] for axis in axes[:2]]
    given = [letter for letter in letters if letter in block.values]
    if not given:
        block.refuse("an arc needs a centre (I, J, K) or a radius (R)")
    if origin is not None and len(given) < 2:
        block.refuse(f"with G90.1 an arc in this plane needs both {letters[0]} and {letters[1]}")
    base = start if origin is None else origin
    a, b = (base[axis] + block.values.get(CENTRE_LETTERS[axis], 0.0) * unit_mm for axis in axes[:2])
    return a, b


def _centre_by_radius(
    block: Block, start: Sequence[float], end: Sequence[float], axes: Axes, clockwise: bool, unit_mm: float
) -> tuple[float, float]:
    """Return the centre of an arc that is given by its radius R.

    The centre is to the left of the chord for a left turn of up to half a turn; a negative R means more than half a
    turn.
    """
    if any(letter in block.values for letter in CENTRE_LETTERS):
        block.refuse("an arc has a centre or a radius, not both")
    a, b, _ = axes
    radius = block.values["R"] * unit_mm
    along = (end[a] - start[a], end[b] - start[b])
    chord = math.hypot(*along)
    if chord <= _SAME_POINT_MM:
        block.refuse("an arc given by its radius cannot end where it begins", "Give its centre")
    if 0.5 * chord > abs(radius) + _RADIUS_SURE_MM:
        block.refuse(f"the radius {abs(radius):g} mm does not reach the end, {chord:g} mm away")
    # Distance of the centre from the chord (Pythagoras). Rounded coordinates can make a half circle's R slightly too
    # short for its chord; the centre is then the middle of the chord.
    height = math.sqrt(max(radius * radius - 0.25 * chord * chord, 0.0))
    # (-along[1], along[0]) points to the left of the chord.
    left = height if clockwise == (radius < 0.0) else -height
    return (
        0.5 * (start[a] + end[a]) - left * along[1] / chord,
        0.5 * (start[b] + end[b]) + left * along[0] / chord,
    )


def _check_radii(block: Block, radius: float, end_radius: float) -> None:
    if min(radius, end_radius) < _SAME_POINT_MM:
        block.refuse("the arc has the radius 0")
    difference = abs(radius - end_radius)
    if difference > _RADIUS_LARGEST_MM or difference > max(_RADIUS_SURE_MM, _RADIUS_SHARE * radius):
        block.refuse(f"the end of the arc is {difference:.4f} mm off its circle", "Check I, J, K and G90.1 or G91.1")


def _directed(turn: float, clockwise: bool) -> float:
    """Return the signed angle of rotation in rad, negative if clockwise.

    Its absolute value is greater than zero and at most a full turn.
    """
    if clockwise:
        return turn if turn < -_NO_TURN_RAD else turn - math.tau
    return turn if turn > _NO_TURN_RAD else turn + math.tau


def _more_turns(block: Block, clockwise: bool) -> float:
    """Return the angle of the additional full turns.

    The word P of an arc is its number of turns; the last turn may be partial.
    """
    turns = block.values.get("P", 1.0)
    if not (turns.is_integer() and 1.0 <= turns <= _MOST_TURNS):
        block.refuse(f"P of an arc is its number of turns: an integer from 1 to {_MOST_TURNS}, not {turns:g}")
    return (turns - 1.0) * (-math.tau if clockwise else math.tau)
