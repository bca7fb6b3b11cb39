"""Misfit: smooth error fields that the error model of a machine cannot represent, with a Gaussian prior.

A machine has more errors than the 18 Legendre series and three squareness values of the model can describe. Gravity and
heat bend the machine in ways that depend on several axes at once. This bending is represented by mixed terms: products
of Legendre polynomials of low total degree. The rails of each axis undulate between their screws. This undulation is
represented by waves: Legendre polynomials of higher orders than those of the model, alone or multiplied by the position
of another axis.

The mixed terms and the waves along each of the three axes are the four kinds of misfit. Each kind has its own scale,
because a machine that bends strongly need not have wavy rails, and one bad rail does not make the other rails bad. The
prior standard deviations of the mixed terms fall with increasing order, as those of the model parameters do. The waves
are the high orders of errors that are stationary along the axis (`series_prior`): their coefficients are
correlated, and the waves are no larger at the ends than in the middle.

The part of the misfit that the model or a rigid motion can represent is removed by least squares over the workspace. An
error that the model can explain is therefore not also explained by the misfit. The rest is condensed to its leading
modes (Karhunen-Loève). The remainder has short wavelengths and is represented by a variance without spatial
correlation.
"""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product

import numpy as np

from twin.arrays import Array
from twin.identification.series_prior import projected_kernel
from twin.machine.error_model import ErrorModel, Ranges
from twin.machine.forward_model import deviation_basis
from twin.machine.legendre import legendre_values, normalise_positions
from twin.machine.rigid_motion import rigid_fields

MISFIT_KINDS = {"mixed terms": 1 / 2, "waves along X": 1 / 6, "waves along Y": 1 / 6, "waves along Z": 1 / 6}
"""Kinds of misfit in their fixed order, each with its share in the prior variance."""

# Prior assumptions of size and shape. `campaigns.foreign` and the study of coverage test them on fields of other kinds.
_MIXED_DEGREE = 6
_ORDERS_BEYOND = 8
_MIXED_DECAY = 0.75  # factor on the prior standard deviation per degree
_WAVE_LENGTH = 1.0  # correlation length of the waves on the axis normalised to [-1, 1], as for the error motions
_LEVER_AMPLITUDE = 0.4  # amplitude of a wave with a lever relative to one without
_MAX_MODES = (17, 12, 12, 12)  # by kind; the remainder is small enough to be treated as uncorrelated
_CHUNK = 1000  # points whose basis is held in memory at a time
_EQUAL = 1e-6  # relative difference of eigenvalues that counts as none
_DEPENDENT = 1e-10  # of the largest eigenvalue: combinations of parameters that do not change the field

Degrees = tuple[int, int, int]


@dataclass(frozen=True, eq=False)
class MisfitModes:
    """Modes of the misfit. A priori, the coefficients of the modes are independent, with mean zero and variance 1.

    Each of the q modes is a combination of c candidate fields, which are products of Legendre polynomials. `degrees`
    contains the Legendre degrees of each candidate in x, y and z. `mixing` (3, c, q) contains, for each direction, the
    amplitude in mm of each candidate in each mode. From each mode, the part that the p parameters of the model or the
    six rigid motions can represent is subtracted. `removed` (p, q) and `rigid` (6, q) contain the amplitudes of the
    subtracted parts.

    `sizes` contains the number of modes of each kind; the modes of a kind form a consecutive block. `left_out` (kinds,)
    is the variance per direction that the modes of each kind leave out, as a mean over the workspace. Modes and
    remainder together have a prior rms of 1.
    """

    model: ErrorModel
    tool_offset: Array
    degrees: tuple[Degrees, ...]
    mixing: Array
    removed: Array
    rigid: Array
    sizes: tuple[int, ...]
    left_out: Array

    @property
    def size(self) -> int:
        return int(self.mixing.shape[2])

    def at(self, axis_positions: Array, basis: Array | None = None) -> Array:
        """Return the values (n, 3, q) in mm of the q modes at axis positions (n, 3) in mm. `basis` (n, 3, p) is the
        derivative of the deviation with respect to the p model parameters at these positions, for a tool with the
        offset `tool_offset`, if it has already been computed."""
        if basis is None:
            basis = deviation_basis(self.model, axis_positions, self.tool_offset)
        candidates = _candidates(self.degrees, self.model.ranges_mm, axis_positions)
        modes = -(basis.reshape(-1, self.model.size) @ self.removed).reshape(len(basis), 3, self.size)
        modes -= _motions(self.model.ranges_mm, axis_positions) @ self.rigid
        for component in range(3):
            modes[:, component] += candidates @ self.mixing[component]
        return modes

    def with_removed(self, removed: Array) -> MisfitModes:
        """Return modes from which the parts `removed` (p, q) of the model parameters are subtracted, and then the
        rigid motion that fits the rest best over the workspace."""
        points, weights = _quadrature(self.model, self.degrees)
        bare = replace(self, removed=removed, rigid=np.zeros_like(self.rigid)).at(points)
        motions, roots = _motions(self.model.ranges_mm, points), np.sqrt(weights)[:, None, None]
        left, right = ((roots * one).reshape(3 * len(points), -1) for one in (motions, bare))
        return replace(self, removed=removed, rigid=np.asarray(np.linalg.lstsq(left, right, rcond=None)[0]))


@lru_cache(maxsize=16)
def misfit_modes(model: ErrorModel, tool_offset: tuple[float, float, float]) -> MisfitModes:
    """Return the modes of the misfit (error fields that `model` cannot represent). From each mode, the part that the
    model can represent for a tool with the offset `tool_offset` in mm is removed."""
    offset = np.array(tool_offset)
    kinds = _kinds(model)
    degrees = tuple(degree for kind in kinds for degree in kind.degrees)
    represented = _Represented.build(model, offset, degrees)
    parts, at = [], 0
    for kind, share, most in zip(kinds, MISFIT_KINDS.values(), _MAX_MODES, strict=True):
        chosen = slice(at, at + len(kind.degrees))
        parts.append(_condense(represented, chosen, kind.factor, share, most))
        at = chosen.stop
    mixing = np.concatenate([part.mixing for part in parts], axis=2)
    removed = represented.share(mixing)
    return MisfitModes(
        model=model,
        tool_offset=offset,
        degrees=degrees,
        mixing=mixing,
        removed=removed[: model.size],
        rigid=removed[model.size :],
        sizes=tuple(part.mixing.shape[2] for part in parts),
        left_out=np.array([part.left_out for part in parts]),
    )


@dataclass(frozen=True, eq=False)
class _Represented:
    """Part of the candidates that k known fields can represent, averaged over the workspace. The known fields are those
    of the model parameters and the rigid motions.

    `inverse` (k, k) is the pseudo-inverse of the Gram matrix of the known fields. `common` (3, k, c) contains the
    products of the known fields and the c candidates for each direction. `squares` (c,) contains the mean square of
    each candidate.
    """

    inverse: Array
    common: Array
    squares: Array

    @classmethod
    def build(cls, model: ErrorModel, offset: Array, degrees: tuple[Degrees, ...]) -> _Represented:
        points, weights = _quadrature(model, degrees)
        count = model.size + _motions(model.ranges_mm, points[:1]).shape[2]
        common, squares = np.zeros((3, count, len(degrees))), np.zeros(len(degrees))
        gram = np.zeros((count, count))
        for start in range(0, len(points), _CHUNK):
            chunk, weight = points[start : start + _CHUNK], weights[start : start + _CHUNK, None]
            known = np.concatenate((deviation_basis(model, chunk, offset), _motions(model.ranges_mm, chunk)), axis=2)
            candidates = _candidates(degrees, model.ranges_mm, chunk)
            squares += weight[:, 0] @ candidates**2
            for direction in range(3):
                one = known[:, direction]
                common[direction] += one.T @ (weight * candidates)
                # Gᵀ G over all three directions: a parameter has one value, whichever direction shows it
                gram += one.T @ (weight * one)
        return cls(_pseudo_inverse(gram), common, squares)

    def share(self, mixing: Array) -> Array:
        """Return the coefficients (k, q) of the known fields contained in combinations `mixing` (3, c, q) of the
        candidates."""
        contained = np.tensordot(self.common, mixing, axes=((0, 2), (0, 1)))
        return np.asarray(self.inverse @ contained)

    def left(self, chosen: slice, factor: Array) -> Array:
        """Return the Gram matrix (3m, 3m) of the m combinations of the `chosen` candidates that are the columns of
        `factor` (m, m), after the represented part has been removed."""
        common = np.concatenate([part[:, chosen] @ factor for part in self.common], axis=1)
        # Legendre polynomials of different degrees are orthogonal over the workspace, so CᵀC is diagonal: the mean
        # squares.
        own = factor.T @ (self.squares[chosen, None] * factor)
        # residual of a least-squares projection on the known fields G: CᵀC - CᵀG (GᵀG)⁻¹ GᵀC
        return np.asarray(np.kron(np.eye(3), own) - common.T @ self.inverse @ common)


@dataclass(frozen=True, eq=False)
class _KindModes:
    """Leading modes of one kind.

    `mixing` (3, c, q) contains the modes as combinations of all c candidates. `left_out` is the variance per direction
    that the modes leave out.
    """

    mixing: Array
    left_out: float


def _condense(represented: _Represented, chosen: slice, factor: Array, share: float, most: int) -> _KindModes:
    rising, vectors = np.linalg.eigh(represented.left(chosen, factor))
    values, vectors = rising[::-1], vectors[:, ::-1]
    # equal modes are kept or left out together: their choice among themselves would be one of rounding
    while most < len(values) and values[most] > (1.0 - _EQUAL) * values[most - 1]:
        most -= 1
    # Karhunen-Loève: leading eigenvectors of the prior covariance, scaled to the kind's share of the variance
    # The sum of all eigenvalues is the mean square over the workspace, so the kind gets its share of the unit variance.
    size = np.sqrt(share / values.sum())
    mixing = np.zeros((3, len(represented.squares), most))
    mixing[:, chosen] = size * factor @ vectors[:, :most].reshape(3, len(factor), most)
    return _KindModes(mixing, float(size**2 * values[most:].sum()) / 3.0)


@dataclass(frozen=True, eq=False)
class _Kind:
    """Candidates of one kind of misfit: their Legendre degrees in x, y, z, and a matrix L (m, m) whose product L Lᵀ is
    their prior covariance up to a factor."""

    degrees: tuple[Degrees, ...]
    factor: Array


def _kinds(model: ErrorModel) -> Sequence[_Kind]:
    waves = [_waves(axis, highest) for axis, highest in enumerate(model.highest_order)]
    return _mixed({degrees for wave in waves for degrees in wave.degrees}), *waves


def _mixed(others: Set[Degrees]) -> _Kind:
    every = range(_MIXED_DEGREE + 1)
    found = {
        # A product of two axes at least (a function of one axis is a wave or a parameter), and no wave with a lever.
        (i, j, k): _MIXED_DECAY ** (i + j + k - 2)
        for i, j, k in product(every, every, every)
        if i + j + k <= _MIXED_DEGREE and sum(degree > 0 for degree in (i, j, k)) > 1 and (i, j, k) not in others
    }
    return _Kind(tuple(found), np.diag(list(found.values())))


def _waves(axis: int, highest: int) -> _Kind:
    """Return the waves along an axis: the part of a stationary error that has a higher order than the model."""
    degrees = []
    for order in range(highest + 1, highest + 1 + _ORDERS_BEYOND):
        for lever in range(3):
            degree = [0, 0, 0]
            degree[lever] = 1
            degree[axis] = order
            degrees.append((degree[0], degree[1], degree[2]))
    beyond = projected_kernel(highest + 1 + _ORDERS_BEYOND, _WAVE_LENGTH)[highest + 1 :, highest + 1 :]
    levers = np.where(np.arange(3) == axis, 1.0, _LEVER_AMPLITUDE)
    return _Kind(tuple(degrees), np.kron(np.linalg.cholesky(beyond), np.diag(levers)))


def _quadrature(model: ErrorModel, degrees: tuple[Degrees, ...]) -> tuple[Array, Array]:
    """Return Gauss-Legendre points (n, 3) over the workspace and their weights (n,), which sum to 1. The quadrature is
    exact for products of any two fields."""
    nodes, weights = [], []
    for axis, (low, high) in enumerate(model.ranges_mm):
        # d + 1 Gauss nodes integrate polynomials of degree 2 d + 1, and products of two fields have at most 2 d.
        node, weight = np.polynomial.legendre.leggauss(max(degree[axis] for degree in degrees) + 1)
        nodes.append(0.5 * (low + high) + 0.5 * (high - low) * node)
        weights.append(0.5 * weight)
    points = np.stack(np.meshgrid(*nodes, indexing="ij"), axis=-1).reshape(-1, 3)
    x, y, z = weights
    return points, np.einsum("i,j,k->ijk", x, y, z).reshape(-1)


def _pseudo_inverse(gram: Array) -> Array:
    """Return the pseudo-inverse of the Gram matrix of fields that may differ greatly in size. Fields that are zero are
    excluded."""
    size = np.sqrt(np.diagonal(gram))
    size = np.where(size > 0.0, size, 1.0)
    values, vectors = np.linalg.eigh(gram / np.multiply.outer(size, size))
    seen = values > _DEPENDENT * values[-1]
    used = vectors[:, seen] / size[:, None]
    return np.asarray((used / values[seen]) @ used.T)


def _candidates(degrees: tuple[Degrees, ...], ranges_mm: Ranges, points: Array) -> Array:
    """Return the candidates (n, c) at points (n, 3): products of Legendre polynomials."""
    tables = []
    for axis in range(3):
        argument = normalise_positions(points[:, axis], ranges_mm[axis])
        tables.append(legendre_values(argument, max(degree[axis] for degree in degrees)))
    columns = np.array(degrees).T
    values: Array = (tables[0][columns[0]] * tables[1][columns[1]] * tables[2][columns[2]]).T
    return values


def _motions(ranges_mm: Ranges, points: Array) -> Array:
    middle = np.array([0.5 * (low + high) for low, high in ranges_mm])
    return rigid_fields(points, middle, max(high - low for low, high in ranges_mm))
