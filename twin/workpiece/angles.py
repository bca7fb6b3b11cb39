"""Predicted angular error motions of the axes (ISO 230-1:2012, 3.4.11): what a level, an autocollimator or an angular
interferometer shows between the tool and the workpiece while one axis moves.

An angle is the difference of the displacements of two tool points, over the distance of these points. It is stated as a
displacement over `SLOPE_LENGTH_MM`, like a squareness: 1 µm over 1000 mm is 1 µrad. A table of corrections moves the
tool point and turns nothing, so the figures with it are those without, and there is one curve.
"""

from __future__ import annotations

import numpy as np

from twin.arrays import Array
from twin.machine.kinematic_chain import AXES
from twin.workpiece.acceptance import SLOPE_LENGTH_MM, AcceptanceTest, PredictedTest
from twin.workpiece.features import Feature, FeatureKind, Measure
from twin.workpiece.machine_field import MachineField, MachineKnowledge, Spread
from twin.workpiece.prediction import COVERAGE_FACTOR, FeaturePrediction, error_of

_ROTATIONS = "ABC"
ANGLES = tuple(f"E{about}{axis}" for axis in AXES for about in _ROTATIONS)
"""Names of the angular error motions."""
_STANDARD = "ISO 230-1"


def predict_angles(
    estimate: MachineKnowledge, lines: tuple[tuple[Array, Array], ...], tool_offset: Array, *, with_table: bool
) -> tuple[PredictedTest, ...]:
    """Return the ranges of the three angular error motions of each axis, with their curves.

    `lines` contains, for X, Y and Z, the axis positions (n, 3) in mm on a line along the axis, and their positions (n,)
    along it. `tool_offset` (3,) is the offset of the tool in mm, and `with_table` is True if figures with a table are
    wanted.
    """
    found = []
    for axis, (axis_positions, along) in enumerate(lines):
        at_tool = MachineField.at(estimate, axis_positions, tool_offset)
        for about in range(3):
            # a turn about Z moves a point ahead in X towards Y
            ahead, across = (about + 1) % 3, (about + 2) % 3
            beside = MachineField.at(estimate, axis_positions, tool_offset + SLOPE_LENGTH_MM * np.eye(3)[ahead])
            used = np.arange(len(along)) * 3 + across
            centred = np.eye(len(along)) - 1.0 / len(along)
            curve = centred @ (beside.expected - at_tool.expected)[used]
            columns = centred @ (beside.columns - at_tool.columns)[used]
            known = columns @ at_tool.covariance @ columns.T
            name = f"E{_ROTATIONS[about]}{AXES[axis]}"
            matrix = centred @ np.kron(np.eye(len(along)), np.eye(3)[across])
            points = axis_positions + tool_offset
            feature = Feature(name, FeatureKind.ACCEPTANCE_TEST, points, matrix, Measure.RANGE, False)
            error = error_of(feature, curve, Spread(known, known))
            found.append(
                PredictedTest(
                    AcceptanceTest(_STANDARD, _title(axis, about), feature, along, matrix),
                    FeaturePrediction(feature, error, error if with_table else None),
                    curve,
                    COVERAGE_FACTOR * np.sqrt(np.maximum(np.diagonal(known), 0.0)),
                    None,
                )
            )
    return tuple(found)


def _title(axis: int, about: int) -> str:
    """Return what an angle is (ISO 230-1:2012, 3.4.12 to 3.4.14); the vertical axis has no pitch and yaw."""
    names = {"axis": AXES[axis], "about": AXES[about]}
    if axis == about:
        return "roll of {axis}, turn about {about}, over 1000 mm".format(**names)
    if AXES[axis] == "Z":
        return "tilt of {axis}, turn about {about}, over 1000 mm".format(**names)
    if AXES[about] == "Z":
        return "yaw of {axis}, turn about {about}, over 1000 mm".format(**names)
    return "pitch of {axis}, turn about {about}, over 1000 mm".format(**names)
