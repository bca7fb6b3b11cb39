"""Comparison of the measured shape of the artefact with its certificate, before anything is identified.

Each position is fitted rigidly, as it stands in the file and under the mistakes that are made with such files: values
in a different unit, a mirrored axis, ball numbers counted from the other end. Errors of the machine are some
micrometres, such mistakes far more. Where they are not, because the certificate is symmetrical within some micrometres,
nothing is said. The rigid fits compare medians over balls, so that a few wrong balls do not decide.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.mount_geometry import MountGeometry
from twin.artefact.observations import Observations
from twin.artefact.position_set import mount_pose
from twin.errors import DataError, PositionError
from twin.identification.checks.outliers import Rows
from twin.identification.poses import RowLayout, rigid_poses
from twin.identification.straight_lines import StraightLines
from twin.units import UM_PER_MM

_MAX_STRAIN = 2e-3  # of the lengths; a bar of steel that is 100 K too warm has 1.2e-3
_UNITS = {1000.0: "µm", 0.1: "cm", 0.001: "m", 1.0 / 25.4: "inch"}  # measured over certified lengths
_UNIT_TOLERANCE = 0.01
_SMALLEST_MM = 1e-3  # residuals below this are equally good
_BETTER = 2.0  # ratio of the median residuals of all positions by which the other reading must be better
_BETTER_ALONE = 4.0  # the same of a single position
_MIN_BALLS_ALONE = 5
_DIRECTION_RAD, _MIRRORED_RAD = 0.05, 0.3  # a mount misses its angles by some mrad
_MIN_BALLS = 3


def check_shape(observations: Observations, artefact: Artefact) -> None:
    """Raise DataError if the measured points have the shape of the artefact in a different unit, in a mirror, or with
    the balls counted from the other end. Raise PositionError if only the balls of a single position are counted from
    the other end.

    Balls that the artefact does not have are left to the identification, which refuses them.
    """
    if (observations.ball >= artefact.count).any():
        return
    layout = RowLayout.of(observations.position)
    seen = observations.select(layout.order)
    points = seen.axis_positions + seen.tool_offsets[seen.tool]
    strain = artefact.cte_per_k * (seen.temperature_c - artefact.reference_temperature_c)
    local = artefact.balls[seen.ball] * (1.0 + strain[:, None])
    _check_unit(layout, local, points)
    found = _residuals(layout, local, points)
    _check_hand(layout, local, points, found)
    if artefact.members:
        return
    if seen.azimuth_rad is not None:
        _check_directions(artefact, layout, seen, local, points)
    reversed_local = artefact.balls[artefact.count - 1 - seen.ball] * (1.0 + strain[:, None])
    _check_numbering(layout, seen.position, found, _residuals(layout, reversed_local, points))


def reversed_fit_mm(artefact: Artefact, ball: Sequence[int], points: Array) -> tuple[float, float] | None:
    """Return evidence that the balls of one position were numbered from the wrong end, or None if there is none.

    The result is the pair of median residuals in mm, with the balls numbered as given and from the other end. It is
    returned only if the second is clearly smaller.

    `ball` contains the numbers of the n measured balls, and `points` (n, 3) their centres in mm.
    """
    layout, numbers = RowLayout.of(np.zeros(len(ball), dtype=np.int64)), np.array(ball)
    if artefact.members or len(ball) < _MIN_BALLS_ALONE:
        return None
    found, other = (
        _median(_residuals(layout, artefact.balls[rows], points)) for rows in (numbers, artefact.count - 1 - numbers)
    )
    return (found, other) if found > _BETTER_ALONE * other else None


def _check_unit(layout: RowLayout, local: Array, points: Array) -> None:
    lengths, certified = _spread(layout, points), _spread(layout, local)
    usable = (layout.counts >= _MIN_BALLS) & (certified > 0.0)
    if not usable.any():
        return
    ratio = float(np.median(lengths[usable] / certified[usable]))
    if abs(ratio - 1.0) <= _MAX_STRAIN:
        return
    unit = next((name for value, name in _UNITS.items() if abs(ratio / value - 1.0) < _UNIT_TOLERANCE), None)
    hint = "check the artefact file, ball numbers and the unit of the coordinates"
    if unit is not None:
        hint = f"the coordinates look like {unit}: give mm"
    raise DataError(
        f"the measured distances between the balls are {ratio:.5g} times those of the certificate", hint=hint
    )


def _check_hand(layout: RowLayout, local: Array, points: Array, found: Array) -> None:
    mirrored = _residuals(layout, local, points * np.array([-1.0, 1.0, 1.0]))
    found_mm, mirrored_mm = _median(found), _median(mirrored)
    if found_mm > _BETTER * mirrored_mm:
        raise DataError(
            f"the balls are a mirror image of the artefact: with one axis mirrored they fit it to {_um(mirrored_mm)}, "
            f"as given to {_um(found_mm)}",
            hint="one axis has the wrong sign or counts from its other end; or the certificate is left-handed",
        )


def _check_directions(artefact: Artefact, layout: RowLayout, seen: Observations, local: Array, points: Array) -> None:
    """Raise DataError if the measured directions of a straight bar are those of the mount with X or Y mirrored.

    The mount may be turned about Z by any angle, and the bar may be clamped end for end. A mirrored Z axis is then the
    same as half a turn about Z with the bar reversed, so that it cannot be told.
    """
    assert seen.azimuth_rad is not None  # noqa: S101  checked by the caller
    lines = StraightLines.of(artefact, [seen.ball])
    if lines is None:
        return
    line = lines.frame[0, :, 0]
    rows = np.split(np.arange(seen.size), np.cumsum(layout.counts)[:-1])
    rows = [part for part in rows if len(part) >= _MIN_BALLS]
    found = np.array([_direction(local[part] @ line, points[part]) for part in rows])
    first = [int(part[0]) for part in rows]
    angles = zip(seen.azimuth_rad[first].tolist(), seen.elevation_rad[first].tolist(), strict=True)
    stated = np.array([mount_pose(np.zeros(3), MountGeometry(), *pair).rotation @ line for pair in angles])
    as_given, mirrored = (_disagreement(stated, found * [side, 1.0, 1.0]) for side in (1.0, -1.0))
    if mirrored < _DIRECTION_RAD and as_given > _MIRRORED_RAD:
        raise DataError(
            "the bar lies at the mirrored azimuths: with X or Y mirrored its directions agree with azimuth_deg and "
            f"elevation_deg to {np.degrees(mirrored):.2g}°, as given to {np.degrees(as_given):.2g}°",
            hint="one axis has the wrong sign or counts from its other end, or the azimuths have the wrong sign",
        )


def _direction(along: Array, points: Array) -> Array:
    """Return the unit vector (3,) of a bar in the measured `points` (m, 3) of its balls. `along` (m,) has the
    coordinates of the balls along the line of the artefact."""
    vector = (along - along.mean()) @ points
    return np.asarray(vector / np.linalg.norm(vector))


def _disagreement(stated: Array, found: Array) -> float:
    """Return the rms angle in rad between directions (K, 3) after the best turn about Z, for a bar clamped either way
    round."""
    best = float("inf")
    for side in (1.0, -1.0):
        turn = np.sum((stated[:, 0] - 1j * stated[:, 1]) * side * (found[:, 0] + 1j * found[:, 1]))
        turn /= max(abs(turn), 1e-12)
        level = (stated[:, 0] + 1j * stated[:, 1]) * turn
        there = np.stack((level.real, level.imag, stated[:, 2]), axis=1)
        best = min(best, float(np.sqrt(np.mean(np.sum((side * found - there) ** 2, axis=1)))))
    return best


def _check_numbering(layout: RowLayout, position: Rows, found: Array, other: Array) -> None:
    found_mm, other_mm = _median(found), _median(other)
    if found_mm > _BETTER * other_mm:
        raise DataError(
            f"the balls are numbered from the other end of the artefact: they fit it to {_um(other_mm)} with reversed "
            f"numbers, and to {_um(found_mm)} as given",
            hint="number the balls in the order of the artefact file, from 0",
        )
    ends = np.cumsum(layout.counts)
    for first, end in zip((ends - layout.counts).tolist(), ends.tolist(), strict=True):
        one_mm, reversed_mm = _median(found[first:end]), _median(other[first:end])
        if end - first >= _MIN_BALLS_ALONE and one_mm > _BETTER_ALONE * reversed_mm:
            raise PositionError(
                int(position[first]),
                f"has its balls numbered from the other end: they fit the artefact to {_um(reversed_mm)} with reversed "
                f"numbers, and to {_um(one_mm)} as given",
                hint="number the balls of this position as those of the others",
            )


def _residuals(layout: RowLayout, local: Array, points: Array) -> Array:
    """Return the distances (n,) in mm of the points from those of the best rigid fit of each position."""
    poses = rigid_poses(layout, local, points)
    return np.asarray(np.linalg.norm(points - poses.to_workpiece(layout, local), axis=1))


def _spread(layout: RowLayout, points: Array) -> Array:
    """Return the rms distance (K,) in mm of the points of each position from their middle."""
    ends = np.cumsum(layout.counts)[:-1]
    return np.array([float(np.sqrt(part.var(axis=0).sum())) for part in np.split(points, ends)])


def _median(residuals: Array) -> float:
    return max(float(np.median(residuals)), _SMALLEST_MM)


def _um(value_mm: float) -> str:
    return f"{UM_PER_MM * value_mm:.3g} µm"
