"""Poses of the artefact: rigid fit per position, small changes of the poses (increments), and elimination of the poses
from the equations."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from twin.arrays import Array
from twin.identification.straight_lines import StraightLines

_COLLINEAR = 1e-9  # second over first singular value of the moments: off-axis below 3e-5 of the length
_ROUNDING = 1e-12  # lever of a roll, relative to the arm of the position, that is rounding alone
_WELL_CONDITIONED = 1e-5  # ratio of eigenvalues of the 6x6 normal equations above which Cholesky loses at most 5 digits
_UNDETERMINED = 1e-10  # relative eigenvalue of the 6x6 normal equations below which an increment is undetermined


@dataclass(frozen=True, eq=False)
class RowLayout:
    """Layout of measured ball centres (rows) as a table with K artefact positions and room for `width` balls (slots)
    per position. Rows are sorted by position. If a position has fewer balls than `width`, its last slots are empty.

    `order` (n,) contains the indices that sort the n given rows by position. `counts` (K,) is the number of balls of
    each position.
    """

    order: np.ndarray[Any, np.dtype[np.int64]]
    counts: np.ndarray[Any, np.dtype[np.int64]]

    @classmethod
    def of(cls, position: np.ndarray[Any, np.dtype[np.int64]]) -> RowLayout:
        order = np.argsort(position, kind="stable")
        return cls(order, np.unique(position, return_counts=True)[1])

    @property
    def positions(self) -> int:
        return len(self.counts)

    @property
    def width(self) -> int:
        return int(self.counts.max())

    @cached_property
    def full(self) -> bool:
        """Flag that is True if all positions have the same number of balls, so that no slot of the table is empty."""
        return bool(self.counts.min() == self.counts.max())

    @cached_property
    def present(self) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """Mask (K, width) that is True for each slot of the table that contains a row (measured ball) and False for
        each empty slot."""
        return np.asarray(np.arange(self.width) < self.counts[:, None])

    @cached_property
    def source(self) -> np.ndarray[Any, np.dtype[np.int64]]:
        """Index (K·width,) of the row (measured ball) in each slot of the table, among the rows sorted by position. An
        empty slot has the index of the first row of its position."""
        starts = np.cumsum(self.counts) - self.counts
        return np.asarray(starts[:, None] + np.arange(self.width) * self.present).reshape(-1)

    @cached_property
    def index(self) -> np.ndarray[Any, np.dtype[np.int64]]:
        """Index (n,), from 0 to K-1, of the artefact position of each of the n rows sorted by position."""
        return np.repeat(np.arange(self.positions), self.counts)

    def pad(self, rows: Array) -> Array:
        """Return `rows` (n, ...), sorted by artefact position, laid out as an array (K, width, ...) with zeros in empty
        slots."""
        shape = (self.positions, self.width, *rows.shape[1:])
        if self.full:
            return rows.reshape(shape)
        padded = rows.take(self.source, axis=0).reshape(shape)
        padded[~self.present] = 0.0
        return padded

    def unpad(self, padded: Array) -> Array:
        """Return the rows (n, ...), sorted by position, of an array (K, width, ...) without its empty slots."""
        return padded.reshape(-1, *padded.shape[2:]) if self.full else padded[self.present]


@dataclass(frozen=True, eq=False)
class Poses:
    """Pose of the artefact in each of K positions. A pose converts a point b in the artefact's frame to the point p = t
    + R b in the workpiece frame.

    `rotation` (K, 3, 3) contains the rotation matrix R of each pose, and `translation` (K, 3) contains the translation
    t in mm.
    """

    rotation: Array
    translation: Array

    def to_workpiece(self, layout: RowLayout, local: Array) -> Array:
        """Return the workpiece coordinates (n, 3) of the artefact points `local` (n, 3). Both arrays are sorted by
        position."""
        turned = layout.pad(local) @ self.rotation.transpose(0, 2, 1)
        turned += self.translation[:, None, :]
        return layout.unpad(turned)

    def moved(self, increments: Array, arms: PoseArms) -> Poses:
        """Return the K poses after small changes `increments` (K, 6) in mm.

        The first three elements of an increment shift the centroid of the balls of the position. The other three
        elements are a rotation about this centroid in rad, multiplied by the arm of the position in mm.
        """
        rotation = rotation_matrices(arms.turns(increments[:, 3:], self)) @ self.rotation
        centroid = self.translation + (self.rotation @ arms.middle[:, :, None])[:, :, 0]
        moved = centroid + increments[:, :3]
        return Poses(rotation, moved - (rotation @ arms.middle[:, :, None])[:, :, 0])


@dataclass(frozen=True, eq=False)
class PoseArms:
    """Arms that convert the rotations of the pose increments to lengths in mm.

    `middle` (K, 3) is the centroid of the balls of each position in the artefact's frame, and `length` (K,) the largest
    distance of a ball from this centroid, both in mm. `lines` describes the positions of straight artefacts; it is None
    if there are none. `pattern` (n, 3) in mm is added to the artefact points for the levers: the measured pattern of a
    straight artefact that is known only roughly.
    """

    middle: Array
    length: Array
    lines: StraightLines | None = None
    pattern: Array | None = None

    @classmethod
    def of(cls, layout: RowLayout, local: Array, lines: StraightLines | None = None) -> PoseArms:
        padded = layout.pad(local)
        middle = padded.sum(axis=1) / layout.counts[:, None]
        offset = (padded - middle[:, None, :]) * layout.present[:, :, None]
        length = np.sqrt(np.einsum("kij,kij->ki", offset, offset).max(axis=1))
        return cls(middle, np.where(length > 0.0, length, 1.0), lines)

    def rotation_columns(self, layout: RowLayout, poses: Poses, local: Array) -> Array:
        """Return the derivatives (K, width, 3, 3) of the points in the workpiece frame with respect to the three
        rotation increments of each position."""
        points = local if self.pattern is None else local + self.pattern
        lever = (layout.pad(points) - self.middle[:, None, :]) @ poses.rotation.transpose(0, 2, 1)
        lever /= self.length[:, None, None]
        # ω × lever for a unit rotation ω about each axis of the workpiece frame
        columns = np.zeros((*lever.shape, 3))
        for one, two, three in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            columns[:, :, three, one] = lever[:, :, two]
            columns[:, :, two, one] = -lever[:, :, three]
        if self.lines is None:
            return columns
        turned = columns @ self.lines.axes(poses.rotation)[:, None]
        # unit size for the roll: its lever is the distance from the line, which is a few micrometres
        roll = turned[..., 0]
        size = np.sqrt(np.einsum("kij,kij->k", roll, roll))
        # nominal centres may stand on an exact line: their lever is rounding, which must not become a column
        scale = np.where(size > _ROUNDING, size, np.inf)
        turned[..., 0] /= np.where(self.lines.straight, scale, 1.0)[:, None, None]
        return turned

    def turns(self, increments: Array, poses: Poses) -> Array:
        """Return the rotation vectors (K, 3) in rad for rotation increments (K, 3) in mm.

        The roll of a straight artefact is left as it is: its linearisation is valid only for small angles.
        """
        turns: Array = increments / self.length[:, None]
        if self.lines is None:
            return turns
        turns[self.lines.straight, 0] = 0.0
        return np.asarray((self.lines.axes(poses.rotation) @ turns[:, :, None])[:, :, 0])


def rigid_poses(
    layout: RowLayout,
    local: Array,
    found: Array,
    lines: StraightLines | None = None,
    nominal: Array | None = None,
) -> Poses:
    """Fit the rigid pose of each position by Kabsch's method, which maps artefact points (n, 3) onto measured points
    (n, 3).

    If the balls of a position lie on one line, the roll about this line cannot be determined. The roll of the rotations
    `nominal` (K, 3, 3), which the mount gives the artefact, is used instead. Without them, the artefact's Y axis is
    assumed to be horizontal.
    """
    counts = layout.counts[:, None]
    here, there = layout.pad(local), layout.pad(found)
    middle, found_middle = here.sum(axis=1) / counts, there.sum(axis=1) / counts
    present = layout.present[:, :, None]
    offset = (here - middle[:, None, :]) * present
    found_offset = (there - found_middle[:, None, :]) * present
    # Kabsch: U S Vᵀ of the cross moments; R = V diag(1, 1, det) Uᵀ is the best proper rotation
    left, weights, right = np.linalg.svd(offset.transpose(0, 2, 1) @ found_offset)
    handedness = np.sign(np.linalg.det(left @ right))
    rotation = _recompose(left, right, handedness)
    collinear = weights[:, 1] <= _COLLINEAR * weights[:, 0]
    if lines is not None:
        collinear |= lines.straight
    for k in np.flatnonzero(collinear):
        # the line along `left` in the artefact is the line along `right` in the workpiece frame
        if nominal is None:
            rotation[k] = _upright_frame(right[k, 0]) @ _upright_frame(left[k, :, 0]).T
        else:
            rotation[k] = _shortest_rotation(nominal[k] @ left[k, :, 0], right[k, 0]) @ nominal[k]
    return Poses(rotation, found_middle - (rotation @ middle[:, :, None])[:, :, 0])


@dataclass(frozen=True, eq=False)
class PoseProjector:
    """Projector that removes the effect of pose increments from the whitened equations of K positions with up to
    `width` balls each.

    `q` (K, 3·width, m) contains an orthonormal basis Q of the effect of m increments for each position; m is 6 unless
    stated otherwise. `back` (K, m, m) converts the projections Qᵀr of residuals r into increments. `seen` is the number
    of increments, over all positions, that the measurements determine.
    """

    q: Array
    back: Array
    seen: int

    @classmethod
    def of(cls, layout: RowLayout, jacobian: Array, weight: Array) -> PoseProjector:
        """Build the projector for increments whose effects are the columns of `jacobian` (K, width, 3, m).

        `weight` (K, width, 3, 3) contains the whitening matrix W of each ball slot. WᵀW is the inverse covariance of
        the ball centre; W is zero in empty slots.
        """
        size = jacobian.shape[-1]
        white = weighted(weight, jacobian).reshape(layout.positions, -1, size)
        gram = white.transpose(0, 2, 1) @ white
        back = _inverse_root(gram)
        if back is not None:
            return cls(white @ back, back, size * layout.positions)
        values, vectors = np.linalg.eigh(gram)
        seen = values > _UNDETERMINED * values[:, -1:]
        inverse_root = np.where(seen, 1.0 / np.sqrt(np.where(seen, values, 1.0)), 0.0)
        back = vectors * inverse_root[:, None, :]
        return cls(white @ back, back, int(seen.sum()))

    def parts(self, white: Array) -> Array:
        """Return the projections QᵀA (K, 6, m) of whitened equations A (K, 3·width, m) of K positions onto the
        orthonormal basis Q of the effect of pose increments."""
        return self.q.transpose(0, 2, 1) @ white

    def increments(self, white: Array) -> Array:
        """Return the small changes (K, 6) of the K poses that fit the whitened right-hand sides (K, 3·width) of the
        equations best in the least-squares sense."""
        return (self.back @ self.parts(white[:, :, None]))[:, :, 0]

    def remove(self, white: Array) -> Array:
        """Return the whitened equations (I - Q Qᵀ) A without the effect of pose increments. Here A (K, 3·width, m)
        contains the whitened equations with this effect, Q is its orthonormal basis, and I is the unit matrix."""
        return white - self.q @ self.parts(white)


def pose_jacobian(layout: RowLayout, poses: Poses, local: Array, arms: PoseArms) -> Array:
    """Return the derivatives (K, width, 3, 6) of the workpiece points of K positions with respect to the six pose
    increments: the unit matrix for the shift, followed by the columns of the rotation."""
    jacobian = np.zeros((layout.positions, layout.width, 3, 6))
    jacobian[..., :3] = np.eye(3)
    jacobian[..., 3:] = arms.rotation_columns(layout, poses, local)
    return jacobian


def weighted(weight: Array, rows: Array, out: Array | None = None) -> Array:
    """Return the products W A of the matrices W (..., 3, 3) in `weight` and the matrices A (..., 3, m) in `rows`.

    If all W are diagonal, for example because each ball has only one standard deviation, the rows of A are only scaled.
    """
    diagonal = np.einsum("...ii->...i", weight)
    if np.count_nonzero(weight) == np.count_nonzero(diagonal):
        return np.asarray(np.multiply(rows, diagonal[..., None], out=out))
    return np.asarray(np.matmul(weight, rows, out=out))


def _inverse_root(gram: Array) -> Array | None:
    """Return matrices B (K, 6, 6) that satisfy Bᵀ G B = 1 for the Gram matrices G in `gram`, computed by Cholesky
    decomposition. Return None if any position does not determine all six increments well."""
    try:
        back = np.linalg.inv(np.linalg.cholesky(gram)).transpose(0, 2, 1)
    except np.linalg.LinAlgError:
        return None
    smallest = 1.0 / np.einsum("kij,kij->k", back, back)  # a lower bound of the smallest eigenvalue
    return back if bool((smallest > _WELL_CONDITIONED * np.einsum("kii->k", gram)).all()) else None


def _recompose(left: Array, right: Array, handedness: Array) -> Array:
    signed = right.transpose(0, 2, 1).copy()
    signed[:, :, 2] *= handedness[:, None]
    return signed @ left.transpose(0, 2, 1)


def _shortest_rotation(start: Array, end: Array) -> Array:
    """Return the rotation (3, 3) by the smallest angle that turns the unit vector `start` into `end`."""
    across = np.cross(start, end)
    sine, cosine = float(np.linalg.norm(across)), float(start @ end)
    if sine < 1e-9:  # parallel, or half a turn about any lateral axis
        across = np.cross(start, np.eye(3)[np.abs(start).argmin()])
    axis = across / np.linalg.norm(across)
    return np.asarray(rotation_matrices(np.arctan2(sine, cosine) * axis[None])[0])


def _upright_frame(axis: Array) -> Array:
    """Return a rotation (3, 3) with `axis` as the first column and a horizontal second column. The second column is the
    Y axis if `axis` is vertical."""
    azimuth = np.arctan2(axis[1], axis[0]) if np.hypot(axis[0], axis[1]) > 1e-9 else 0.0
    lateral = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    return np.column_stack((axis, lateral, np.cross(axis, lateral)))


def rotation_matrices(turns: Array) -> Array:
    """Return the rotation matrices (K, 3, 3) of rotation vectors (K, 3) in rad (Rodrigues)."""
    angle = np.sqrt(np.einsum("ki,ki->k", turns, turns))
    cross = np.zeros((len(turns), 3, 3))
    cross[:, [2, 0, 1], [1, 2, 0]] = turns
    cross[:, [1, 2, 0], [2, 0, 1]] = -turns
    divisor = np.where(angle > 0.0, angle, 1.0)
    first = np.where(angle > 0.0, np.sin(angle) / divisor, 1.0)
    second = np.where(angle > 0.0, 2.0 * (np.sin(0.5 * angle) / divisor) ** 2, 0.5)
    rotation: Array = np.eye(3) + first[:, None, None] * cross + second[:, None, None] * (cross @ cross)
    return rotation
