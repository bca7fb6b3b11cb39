"""What the model cannot represent: a small set of smooth fields beside it, with a Gaussian prior.

A machine has more than 21 Legendre series: rails wave between their screws, gravity bends it, and no series ends at the
order of the model. The candidates are products of Legendre polynomials of the three axis positions, each displacement
alike: orders above the model's, alone and with a linear lever in another axis, and mixed terms of low total degree.
Their prior standard deviations fall with the order as those of families do. What the model or a rigid motion can
represent of them is taken out by least squares over the workspace, so that the two never compete; the rest is condensed
to its leading modes (Karhunen-Loève), normalised to a prior rms of 1 over the workspace.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np

from twin.arrays import Array
from twin.error_model import ErrorModel, Ranges
from twin.legendre import legendre_values, normalised
from twin.machine_model import deviation_basis
from twin.rigid_motion import rigid_fields

_MIXED_DEGREE = 4
_ORDERS_BEYOND = 4
_DECAY = 0.75  # prior standard deviation per order; rail waves fall off more slowly than the series themselves
_LEVER = 0.4  # of a term with a lever beside the one without
_MIXED = 0.5  # of the lowest mixed term beside the first order beyond the model
_KEPT_VARIANCE = 0.95
_MOST_MODES = 40

Degrees = tuple[int, int, int]


@dataclass(frozen=True, eq=False)
class MisfitModes:
    """Modes with unit-normal coefficients: field = candidates · `mixing` - model and rigid motion · `removed`.

    `degrees` Legendre degrees in x, y, z of each candidate (c); `mixing` (3, c, q) mm; `removed` (p, q);
    `rigid` (6, q).
    """

    model: ErrorModel
    tool_offset: Array
    degrees: tuple[Degrees, ...]
    mixing: Array
    removed: Array
    rigid: Array

    @property
    def size(self) -> int:
        return int(self.mixing.shape[2])

    def at(self, axis_positions: Array, basis: Array | None = None) -> Array:
        """Modes (n, 3, q) mm at axis positions (n, 3). `basis`: the model's there for this tool, if at hand."""
        if basis is None:
            basis = deviation_basis(self.model, axis_positions, self.tool_offset)
        candidates = _candidates(self.degrees, self.model.ranges_mm, axis_positions)
        modes = -(basis.reshape(-1, self.model.size) @ self.removed).reshape(len(basis), 3, self.size)
        modes -= _motions(self.model.ranges_mm, axis_positions) @ self.rigid
        for component in range(3):
            modes[:, component] += candidates @ self.mixing[component]
        return modes


@lru_cache(maxsize=16)
def misfit_modes(model: ErrorModel, tool_offset: tuple[float, float, float]) -> MisfitModes:
    """Modes for a model and the tool offset (mm) for which the two are kept apart."""
    offset = np.array(tool_offset)
    candidates = _weighted_candidates(model)
    degrees, deviations = tuple(candidates), np.array(list(candidates.values()))
    points, weights = _quadrature(model)
    root = np.sqrt(weights)[:, None, None]
    basis = deviation_basis(model, points, offset)
    scale = np.sqrt(np.einsum("n,ncp->p", weights, basis**2))
    scale = np.where(scale > 0.0, scale, 1.0)
    known = np.concatenate((basis / scale, _motions(model.ranges_mm, points)), axis=2) * root
    known = known.reshape(-1, known.shape[2])
    wanted = np.einsum("nq,cd->ncdq", _candidates(degrees, model.ranges_mm, points) * deviations, np.eye(3))
    wanted = (wanted * root[..., None]).reshape(len(known), -1)
    share = np.linalg.lstsq(known, wanted, rcond=1e-9)[0]
    left = wanted - known @ share
    values, vectors = np.linalg.eigh(left.T @ left)
    count = _count(values[::-1])
    modes = vectors[:, ::-1][:, :count] / np.sqrt(values[::-1][:count].sum())
    share = share @ modes
    return MisfitModes(
        model=model,
        tool_offset=offset,
        degrees=degrees,
        mixing=modes.reshape(3, len(degrees), -1) * deviations[:, None],
        removed=share[: model.size] / scale[:, None],
        rigid=share[model.size :],
    )


def _weighted_candidates(model: ErrorModel) -> dict[Degrees, float]:
    """Degrees in x, y, z of each candidate and its prior standard deviation, relative."""
    found: dict[Degrees, float] = {}
    every = range(_MIXED_DEGREE + 1)
    for i, j, k in product(every, every, every):
        if i + j + k <= _MIXED_DEGREE and sum(degree > 0 for degree in (i, j, k)) > 1:
            found[i, j, k] = _MIXED * _DECAY ** (i + j + k - 2)
    for axis, highest in enumerate(model.highest_order):
        for beyond in range(_ORDERS_BEYOND):
            for lever in range(3):
                degree = [0, 0, 0]
                degree[lever] = 1
                degree[axis] = highest + 1 + beyond
                found[(degree[0], degree[1], degree[2])] = _DECAY**beyond * (1.0 if lever == axis else _LEVER)
    return found


def _quadrature(model: ErrorModel) -> tuple[Array, Array]:
    """Gauss-Legendre points (n, 3) over the workspace and weights (n,) that sum to 1."""
    nodes, weights = [], []
    for (low, high), order in zip(model.ranges_mm, model.highest_order, strict=True):
        node, weight = np.polynomial.legendre.leggauss(max(order, _MIXED_DEGREE) + _ORDERS_BEYOND + 2)
        nodes.append(0.5 * (low + high) + 0.5 * (high - low) * node)
        weights.append(0.5 * weight)
    points = np.stack(np.meshgrid(*nodes, indexing="ij"), axis=-1).reshape(-1, 3)
    x, y, z = weights
    return points, np.einsum("i,j,k->ijk", x, y, z).reshape(-1)


def _candidates(degrees: tuple[Degrees, ...], ranges_mm: Ranges, points: Array) -> Array:
    """(n, c) products of Legendre polynomials."""
    tables = []
    for axis in range(3):
        argument = normalised(points[:, axis], ranges_mm[axis])
        tables.append(legendre_values(argument, max(degree[axis] for degree in degrees)))
    columns = np.array(degrees).T
    values: Array = (tables[0][columns[0]] * tables[1][columns[1]] * tables[2][columns[2]]).T
    return values


def _motions(ranges_mm: Ranges, points: Array) -> Array:
    middle = np.array([0.5 * (low + high) for low, high in ranges_mm])
    return rigid_fields(points, middle, max(high - low for low, high in ranges_mm))


def _count(falling: Array) -> int:
    share = np.cumsum(falling) / falling.sum()
    enough = int(np.searchsorted(share, _KEPT_VARIANCE)) + 1
    return min(enough, _MOST_MODES, len(falling))
