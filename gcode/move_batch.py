"""Numerical processing of many moves at once. Moves are divided into pieces, points are corrected, and axis words are
rounded.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gcode.arcs import Arc, arc_points
from gcode.chord_tolerance import TableCurvature
from gcode.modal import Frame
from twin.arrays import Array
from twin.compensation.table import CompensationTable

Indices = NDArray[np.int64]
Flags = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class MovePaths:
    """Paths of m consecutive moves. `starts` and `ends` (m, 3) are axis positions in mm. `arcs` maps the index of a
    move to its arc if the move is an arc.
    """

    starts: Array
    ends: Array
    arcs: Mapping[int, Arc]

    def pieces(self, bending: TableCurvature, dividable: Flags, limit_mm: float) -> Indices:
        """Return the number of pieces into which each of the m moves has to be divided, so that the straight lines
        deviate from the corrected path by at most `limit_mm`. Straight moves for which `dividable` is False are not
        divided.
        """
        count = bending.line_pieces(self.starts, self.ends, limit_mm)
        count[~dividable] = 1
        if self.arcs:
            rows = np.fromiter(self.arcs, dtype=np.int64)
            count[rows] = self._arc_pieces(rows, bending, limit_mm)
        return count

    def points(self, first: int, pieces: Indices) -> tuple[Array, Indices, Flags]:
        """Return the end points of all pieces of consecutive moves. `first` is the index of the first of these moves,
        and `pieces` contains the number of pieces of each.

        The result consists of three arrays with one element per point: the points (n, 3) in mm, the index of the
        point's move, and a flag. The flag is True if the point is the end of its move.
        """
        total = int(pieces.sum())
        rows = np.repeat(np.arange(len(pieces)), pieces) + first
        # Points of all earlier moves, so that `number` counts 1, 2, … within each move.
        before = np.repeat(np.cumsum(pieces) - pieces, pieces)
        number = np.arange(1, total + 1) - before
        last = number == np.repeat(pieces, pieces)
        share = number / np.repeat(pieces, pieces)
        points = self.starts[rows] + share[:, None] * (self.ends[rows] - self.starts[rows])
        curved = [row for row in self.arcs if first <= row < first + len(pieces)]
        if curved:
            self._bend(points, rows, share, curved)
        # start + 1.0 · (end - start) differs from the end by floating-point noise, which would change a rounded word.
        points[last] = self.ends[rows[last]]
        return points, rows, last

    def _bend(self, points: Array, rows: Indices, share: Array, curved: list[int]) -> None:
        """Move the points of arcs from the chord onto the arc, in place."""
        # Number of each move among the arcs; -1 for straight moves.
        place = np.full(len(self.ends), -1)
        place[curved] = np.arange(len(curved))
        which = place[rows]
        on_arc = which >= 0
        arcs = [self.arcs[row] for row in curved]
        starts, ends = self.starts[curved], self.ends[curved]
        points[on_arc] = arc_points(arcs, which[on_arc], share[on_arc], starts, ends)

    def _arc_pieces(self, rows: Indices, bending: TableCurvature, limit_mm: float) -> Indices:
        lower, upper = np.minimum(self.starts[rows], self.ends[rows]), np.maximum(self.starts[rows], self.ends[rows])
        sizes = []
        for place, row in enumerate(rows.tolist()):
            arc = self.arcs[row]
            largest = max(arc.radius, arc.end_radius)
            # The box of the whole circle: the arc may reach any side of it. Along the normal axis the box ends at the
            # ends of the arc. (zip stops after the two axes of the plane.)
            for axis, middle in zip(arc.axes, arc.centre, strict=False):
                lower[place, axis], upper[place, axis] = middle - largest, middle + largest
            rise = float(self.ends[row, arc.axes[2]] - self.starts[row, arc.axes[2]])
            sizes.append((largest, arc.end_radius - arc.radius, rise, arc.sweep))
        radius, widening, rise, sweep = np.array(sizes).T
        # With the share t of the way, the spiral has the radius r + w t and the angle φ t. Its second derivative by t
        # has the components r φ² (inward) and 2 w φ (along the turn). By the square of the length it is the curvature.
        length = np.sqrt((radius * sweep) ** 2 + widening**2 + rise**2)
        curvature = (radius * sweep**2 + 2.0 * np.abs(widening * sweep)) / length**2
        return bending.arc_pieces(lower, upper, length, curvature, sweep, limit_mm)


@dataclass(frozen=True, eq=False)
class AxisWords:
    """Rounded axis words of n points.

    `values` (n, 3) contains the numbers of the X, Y and Z words. `changed` (n, 3) is True if the word has to be
    written. `position` (n, 3) contains the axis positions of the controller in mm after execution of the words.
    """

    values: Array
    changed: Flags
    position: Array


def round_to_words(
    points: Array, frames: Sequence[Frame], rows: Indices, position: Sequence[float], unit_mm: float, decimals: int
) -> AxisWords:
    """Convert n corrected points (n, 3) in mm to axis words with `decimals` decimals.

    `rows` (n,) contains the index of each point's frame in `frames`. A frame gives the controller's zero point, and
    determines whether the words of the point are absolute or incremental. An absolute word is the rounded distance of
    the point from the zero point of the frame. An incremental word is the rounded distance of the point from the
    position that the controller reaches with the preceding words. Rounding errors do not accumulate. `position` is the
    position of the controller before the first point.
    """
    # Length in mm of one unit of the last decimal; words are whole numbers of steps.
    step = unit_mm * 10.0**-decimals
    frame = np.array(frames)[rows]
    absolute = frame[:, 3] != 0.0
    # First as if all words were absolute.
    base = frame[:, :3].copy()
    counted = np.rint((points - base) / step)
    reached = base + counted * step
    if not absolute.all():
        # Index of the last absolute point before each incremental one. Words between them are rounded from what that
        # point reached, so that the sum of the rounded words is the rounded sum.
        before = np.maximum.accumulate(np.where(absolute, np.arange(len(points)), -1))[~absolute]
        base[~absolute] = np.where(before[:, None] >= 0, reached[before], np.asarray(position))
        reached[~absolute] = base[~absolute] + np.rint((points[~absolute] - base[~absolute]) / step) * step
    change = np.diff(reached, axis=0, prepend=np.asarray(position)[None, :])
    counted[~absolute] = np.rint(change[~absolute] / step)
    # Adding 0.0 turns -0.0 into 0.0. Words of one frame reach positions that are whole steps apart, so a quarter of a
    # step tells a change from floating-point noise.
    return AxisWords(np.round(counted * 10.0**-decimals, decimals) + 0.0, np.abs(change) > 0.25 * step, reached)


@dataclass(frozen=True, eq=False)
class CorrectedPoints:
    """Corrected points, and their distances from the volume of the compensation table.

    - `points` (n, 3) contains the axis positions to be commanded in mm.
    - `largest_mm` is the length of the largest correction.
    - `beyond_mm` (n,) is the distance of each programmed point from the border of the volume. It is positive if the
      point is outside.
    - `held_mm` (n,) is the amount by which the correction of each point was limited to keep the point in the volume.
    - `extrapolated` is the number of points whose correction depends on a table node outside the measured region.
    """

    points: Array
    largest_mm: float
    beyond_mm: Array
    held_mm: Array
    extrapolated: int


def correct_points(table: CompensationTable, points: Array, *, held: bool) -> CorrectedPoints:
    """Add the corrections of a compensation table to points (n, 3) in mm.

    If `held` is True, corrected points outside the volume of the table are moved to its border. The border of the
    volume is usually the limit of the travel, and a controller stops with an error if a position exceeds this limit by
    a µm.
    """
    lower = np.array([nodes[0] for nodes in table.nodes])
    upper = np.array([nodes[-1] for nodes in table.nodes])
    correction = table.at(points)
    wanted = points + correction
    allowed = np.clip(wanted, lower, upper) if held else wanted
    beyond = np.maximum(lower - points, points - upper).max(axis=1)
    return CorrectedPoints(
        points=allowed,
        largest_mm=float(np.sqrt((correction * correction).sum(axis=1)).max(initial=0.0)),
        beyond_mm=beyond,
        held_mm=np.abs(wanted - allowed).max(axis=1),
        extrapolated=_extrapolated(table, points) if table.extrapolated.any() else 0,
    )


def _extrapolated(table: CompensationTable, points: Array) -> int:
    """Count the points that depend on a node outside the measured region."""
    # Trilinear interpolation uses the eight nodes of a cell. Outside the table the nearest border nodes act, hence the
    # clip.
    near = [np.searchsorted(nodes, points[:, k]) for k, nodes in enumerate(table.nodes)]
    found = np.zeros(len(points), dtype=bool)
    for corner in np.ndindex(2, 2, 2):
        place = [np.clip(n - side, 0, len(nodes) - 1) for n, side, nodes in zip(near, corner, table.nodes, strict=True)]
        found |= table.extrapolated[place[0], place[1], place[2]]
    return int(found.sum())
