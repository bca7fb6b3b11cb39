"""Volumetric error: the rms length of the deviation over a grid of axis positions.

A rigid motion of the whole workspace is not a machine error, and an artefact whose pose is unknown cannot reveal it.
Every volumetric error is therefore given twice: raw, and aligned. If a field is linear in its parameters E, with the
basis matrix B at n points, its mean square is the quadratic form Eᵀ (BᵀB / n) E. The grid therefore has to be evaluated
only once for any number of parameter vectors.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from twin.arrays import Array, as_points, as_vector
from twin.errors import DataError, ModelError
from twin.machine.error_model import ErrorModel, Ranges
from twin.machine.forward_model import deviation_basis
from twin.machine.grid_quadrature import GridQuadrature
from twin.machine.kinematic_chain import AXES
from twin.machine.rigid_motion import rigid_fields

_CHUNK = 2000  # grid points whose basis is in memory at a time
_END_TOLERANCE = 1e-9  # relative to the range


@dataclass(frozen=True)
class VolumetricRms:
    """Rms length of a field of deviations, in mm.

    `raw_mm` is the rms of the field itself; `aligned_mm` is the rms after the best-fitting rigid motion of the
    workspace has been removed.
    """

    raw_mm: float
    aligned_mm: float

    @property
    def raw_um(self) -> float:
        return 1e3 * self.raw_mm

    @property
    def aligned_um(self) -> float:
        return 1e3 * self.aligned_mm


def evaluation_grid(ranges_mm: Ranges, shape: tuple[int, int, int] = (60, 20, 20)) -> Array:
    """Return the axis positions, shape (n, 3), of a regular grid over the axis ranges, including their ends.

    The x position changes slowest and the z position fastest. Raises ModelError if an axis has fewer than two points.
    """
    x, y, z = (np.linspace(low, high, max(count, 0)) for (low, high), count in zip(ranges_mm, shape, strict=True))
    return covering_grid(ranges_mm, (x, y, z))


def covering_grid(ranges_mm: Ranges, nodes: tuple[ArrayLike, ArrayLike, ArrayLike]) -> Array:
    """Return the axis positions, shape (n, 3), of the grid with the given `nodes` in mm along X, Y and Z.

    The x position changes slowest and the z position fastest. An rms over only a part of the workspace is not a
    volumetric error. Therefore ModelError, which names the axis, is raised if the nodes of an axis do not ascend from
    one end of its range to the other.
    """
    lines = [np.asarray(line, dtype=np.float64) for line in nodes]
    for axis, line, (low, high) in zip(AXES, lines, ranges_mm, strict=True):
        _refuse_gap(axis, line, low, high)
    return np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3)


def _refuse_gap(axis: str, nodes: Array, low: float, high: float) -> None:
    hint = f"Provide at least two ascending points from {low:g} to {high:g} mm"
    if nodes.ndim != 1 or len(nodes) < 2 or not np.isfinite(nodes).all() or not (np.diff(nodes) > 0.0).all():
        given = "points that do not ascend" if nodes.size > 1 else "1 point" if nodes.size else "no points"
        raise ModelError(f"a grid with {given} does not cover the workspace", hint=hint, axis=axis)
    room = _END_TOLERANCE * (high - low)
    if nodes[0] > low + room or nodes[-1] < high - room:
        message = f"the grid from {nodes[0]:g} to {nodes[-1]:g} mm does not cover the workspace"
        raise ModelError(message, hint=hint, axis=axis)


def rms(deviation: Array) -> float:
    """Return the root mean square length of the n deviation vectors in an array of shape (n, 3)."""
    return float(np.sqrt(np.mean(np.einsum("ij,ij->i", deviation, deviation))))


def align_rigidly(points: ArrayLike, deviation: ArrayLike) -> Array:
    """Remove the best-fitting small rigid motion from `deviation` and return the residual, shape (n, 3).

    `deviation`, shape (n, 3), is given at the tool points `points`, shape (n, 3). The translation and the small
    rotation are fitted by least squares with equal weights. A rotation that the tool points do not determine (because
    there are too few of them or they are collinear) is not fitted.
    """
    field = as_points(deviation, "deviation")
    motions = _rigid_motions(as_points(points, "points"))
    flat = field.reshape(-1)
    return field - (motions @ (motions.T @ flat)).reshape(-1, 3)


def rigid_part(points: ArrayLike, deviation: ArrayLike, elsewhere: ArrayLike) -> Array:
    """Fit a small rigid motion to a deviation, and return the displacements that this motion causes at other points.

    `deviation`, shape (n, 3), is given at the tool points `points`, shape (n, 3). The result, shape (m, 3), applies to
    the points `elsewhere`, shape (m, 3).
    """
    at, field, other = (as_points(each, "points") for each in (points, deviation, elsewhere))
    middle, size_mm = at.mean(axis=0), max(float(np.ptp(at, axis=0).max()), 1.0)
    fields = rigid_fields(at, middle, size_mm).reshape(-1, 6)
    motion = np.linalg.lstsq(fields, field.reshape(-1), rcond=1e-9)[0]
    return np.asarray(rigid_fields(other, middle, size_mm) @ motion)


def volumetric_error(points: ArrayLike, deviation: ArrayLike) -> VolumetricRms:
    """Return the raw and the aligned rms of a field of deviations, shape (n, 3), given at tool points, shape (n, 3)."""
    field = as_points(deviation, "deviation")
    return VolumetricRms(rms(field), rms(align_rigidly(points, field)))


@dataclass(frozen=True)
class QuadraticForm:
    """Mean square of a deviation field over a grid, as a quadratic function of the p model parameters.

    The field is linear in the parameters. A fixed field, which does not depend on the parameters, can be added.

    `raw` and `aligned`, shape (p, p), are the quadratic coefficients in mm² per product of two parameter units;
    `aligned` applies after the best-fitting rigid motion has been removed from the field. The fixed field causes the
    linear coefficients `raw_linear` and `aligned_linear`, shape (p,), and the constants `raw_constant` and
    `aligned_constant`. All of these are zero if there is no fixed field.
    """

    model: ErrorModel
    axis_positions: Array
    tool_offset: Array
    raw: Array
    aligned: Array
    raw_linear: Array
    aligned_linear: Array
    raw_constant: float = 0.0
    aligned_constant: float = 0.0

    @classmethod
    def build(cls, model: ErrorModel, axis_positions: ArrayLike, tool_offset: ArrayLike) -> QuadraticForm:
        """Build the quadratic form of the deviations that `model` gives on a grid of axis positions for one tool
        offset.

        `axis_positions` has shape (n, 3) and `tool_offset` has shape (3,); both are in mm.
        """
        points = as_points(axis_positions, "axis positions")
        offset = as_vector(tool_offset, 3, "tool offset")
        sums = GridQuadrature.for_points(points, model.field_degrees)
        gram, shared = np.zeros((model.size, model.size)), np.zeros((6, model.size))
        roots = np.sqrt(sums.weights).repeat(3)[:, None]
        motions = _rigid_motions(sums.nodes + offset, sums.weights)
        for rows, basis in _basis_chunks(model, sums.nodes, offset):
            weighted = roots[rows] * basis
            gram += weighted.T @ weighted
            shared[: motions.shape[1]] += motions[rows].T @ weighted
        # raw: BᵀB / n; aligned: Bᵀ(1 - M Mᵀ)B / n with the orthonormal rigid motions M
        raw, aligned = gram / len(points), (gram - shared.T @ shared) / len(points)
        return cls(model, points, offset, raw, aligned, np.zeros(model.size), np.zeros(model.size))

    def with_field(self, field: ArrayLike) -> QuadraticForm:
        """Return a quadratic form that also includes a fixed field on the same grid.

        `field`, shape (n, 3), contains the deviations in mm that are added to the field that is linear in the
        parameters.
        """
        fixed = as_points(field, "field")
        if fixed.shape != self.axis_positions.shape:
            raise DataError(f"the field has {len(fixed)} points, the grid {len(self.axis_positions)}")
        sums = GridQuadrature.for_points(self.axis_positions, self.model.field_degrees)
        roots = np.sqrt(sums.weights).repeat(3)
        motions = _rigid_motions(sums.nodes + self.tool_offset, sums.weights)
        # A grid field is no polynomial. Its projection gives the same products with every basis column, but not the
        # same square: fᵀf is taken on the grid itself.
        gathered = sums.gather(fixed).reshape(-1)
        # |B E + f|² = EᵀBᵀB E + 2 fᵀB E + fᵀf; aligned: f without its rigid part M Mᵀf
        rigid = motions.T @ (gathered / roots)
        both = np.stack((gathered, gathered - roots * (motions @ rigid)))
        linear = np.zeros((2, self.model.size))
        for rows, basis in _basis_chunks(self.model, sums.nodes, self.tool_offset):
            linear += both[:, rows] @ basis
        raw_linear, aligned_linear = linear / len(fixed)
        return replace(
            self,
            raw_linear=raw_linear,
            aligned_linear=aligned_linear,
            raw_constant=rms(fixed) ** 2,
            aligned_constant=max(rms(fixed) ** 2 - float(rigid @ rigid) / len(fixed), 0.0),
        )

    def values(self, parameters: ArrayLike) -> tuple[Array, Array]:
        """Return the volumetric errors of m machines in mm, raw and aligned, as two arrays of shape (m,).

        Aligned means after the best-fitting rigid motion has been removed. `parameters`, shape (m, p), has one row for
        each machine.
        """
        vectors = np.asarray(parameters, dtype=np.float64)
        if vectors.ndim != 2 or vectors.shape[1] != self.model.size:
            raise ModelError(f"parameters have shape {vectors.shape}, expected (m, {self.model.size})")
        raw = _mean_squares(vectors, self.raw, self.raw_linear, self.raw_constant)
        aligned = _mean_squares(vectors, self.aligned, self.aligned_linear, self.aligned_constant)
        return np.sqrt(raw), np.sqrt(aligned)

    def value(self, parameters: ArrayLike, field: ArrayLike | None = None) -> VolumetricRms:
        """Return the volumetric error of one machine with `parameters`, shape (p,), and an optional fixed `field`.

        `field`, shape (n, 3), contains deviations in mm that are added to those that the parameters cause. To evaluate
        many machines with the same fixed field, call `with_field` once and then `values`.
        """
        form = self if field is None else self.with_field(field)
        raw, aligned = form.values(as_vector(parameters, self.model.size, "parameters")[None, :])
        return VolumetricRms(float(raw[0]), float(aligned[0]))

    def expected(self, covariance: Array) -> VolumetricRms:
        """Return the volumetric error expected over machines with random parameters, raw and aligned.

        The parameters have mean zero and the `covariance` P, shape (p, p). The expected value is the root of the
        expected mean square, sqrt(trace(Q P) + c), where Q is the matrix `raw` or `aligned` of this form, and c is the
        mean square of the fixed field (zero if there is none).
        """
        raw = float(np.einsum("ij,ji->", self.raw, covariance)) + self.raw_constant
        aligned = float(np.einsum("ij,ji->", self.aligned, covariance)) + self.aligned_constant
        return VolumetricRms(float(np.sqrt(max(raw, 0.0))), float(np.sqrt(max(aligned, 0.0))))


def _mean_squares(vectors: Array, form: Array, linear: Array, constant: float) -> Array:
    quadratic = np.einsum("ij,ij->i", vectors @ form, vectors)
    mean_squares: Array = np.maximum(quadratic + 2.0 * (vectors @ linear) + constant, 0.0)
    return mean_squares


def _basis_chunks(model: ErrorModel, points: Array, offset: Array) -> Iterator[tuple[slice, Array]]:
    """Yield the row slice (of the flattened field) and the basis (rows, p) of successive chunks of the grid."""
    for start in range(0, len(points), _CHUNK):
        chunk = points[start : start + _CHUNK]
        basis = deviation_basis(model, chunk, offset).reshape(-1, model.size)
        yield slice(3 * start, 3 * (start + len(chunk))), basis


def _rigid_motions(points: Array, weights: Array | None = None) -> Array:
    """Return an orthonormal basis (3n, r) of the small rigid motions of points (n, 3); r = 6 unless they are collinear.

    `weights` (n,): weights of the points in a sum of squares; if given, the fields are multiplied by their square
    roots.
    """
    middle = points.mean(axis=0)
    # Rotations about the middle, scaled by the rms distance, displace points about as far as translations, which keeps
    # the singular values comparable.
    size = max(float(np.sqrt(np.mean((points - middle) ** 2))), 1e-12)
    fields = rigid_fields(points, middle, size)
    if weights is not None:
        fields *= np.sqrt(weights)[:, None, None]
    left, sizes, _ = np.linalg.svd(fields.reshape(-1, 6), full_matrices=False)
    # points on one line leave the rotation about it undetermined, a singular value of zero
    used: Array = left[:, sizes > 1e-9 * sizes[0]]
    return used
