"""Observability of a model's parameters by a measuring set-up. Null directions are described in words.

Information matrices refer to unit-prior coordinates: each parameter is in units of its prior standard deviation, which
makes mm and rad comparable. A null direction is a combination of parameters that leaves all measurements unchanged.
Some null directions also leave the whole error field at the tool point unchanged. These null directions are harmless if
there is only one tool.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from twin.arrays import Array
from twin.machine.error_model import ErrorModel
from twin.machine.forward_model import deviation_basis
from twin.machine.kinematic_chain import AXES
from twin.machine.rigid_motion import rigid_fields
from twin.machine.volumetric import evaluation_grid

_NULL_EIGENVALUE = 1e-10  # of the largest eigenvalue: rounding of the normal equations stays below
_MIN_LOADING = 1e-4  # of the largest loading
_FIELD_NULL = 1e-9
_MAX_PARTNERS = 4
FIXED = "because the family holds it at its prior value"


@dataclass(frozen=True)
class NullDirection:
    """Combination of parameters that the measurements do not determine.

    `text` describes the combination in words. `loadings` contains the change of each parameter involved, in the unit of
    that parameter, if the first of these parameters changes by one prior standard deviation. `changes_field` is True if
    the direction moves the tool point relative to the workpiece by more than a rigid motion. `circumstance` is the part
    of `text` that states under which circumstances the direction is not observed.
    """

    text: str
    loadings: Mapping[str, float]
    changes_field: bool
    circumstance: str


@dataclass(frozen=True)
class Observability:
    """Observability of the p parameters of an error model by measurements.

    `rank` is the number of parameter combinations that the measurements determine, and `null_directions` contains the
    other combinations, which they do not determine. `conditioning` is the ratio of the largest to the smallest singular
    value of the measurement equations in the determined directions.
    """

    rank: int
    null_directions: tuple[NullDirection, ...]
    conditioning: float


def field_observability(model: ErrorModel, scale: Array, tool_offsets: Array, aligned: bool = False) -> Observability:
    """Return the best observability of the p model parameters that any set of artefact positions can reach with T tools
    of the offsets `tool_offsets` (T, 3) in mm. It is reached if the error field of these T tools is measured
    everywhere.

    Parameters are in units of `scale` (p,). If `aligned` is True, a rigid motion of the workspace does not count as a
    change of the error field.
    """
    form = field_form(model, scale, tool_offsets, aligned)
    return observability(model, form, scale, tool_offsets, "by the tool point")


def observability(
    model: ErrorModel, information: Array, scale: Array, tool_offsets: Array, observer: str = "by this set"
) -> Observability:
    """Return the rank, the null directions in words, and the conditioning of an information matrix (p, p). The matrix
    refers to parameters in units of `scale` (p,).

    `observer` completes the phrase "not seen …" in the descriptions of the null directions, for example "by this set".
    """
    values, vectors = np.linalg.eigh(information)
    open_ = values <= _NULL_EIGENVALUE * max(float(values[-1]), 1e-300)
    used = values[~open_]
    conditioning = float(np.sqrt(used[-1] / used[0])) if used.size else float("inf")
    directions = _directions(model, vectors[:, open_], scale, tool_offsets, observer)
    return Observability(int(used.size), directions, conditioning)


def null_space(information: Array) -> Array:
    """Return an orthonormal basis (p, r) of the null space of an information matrix (p, p), with each parameter in
    units of its prior standard deviation. The null space has r dimensions."""
    values, vectors = np.linalg.eigh(information)
    return np.asarray(vectors[:, values <= _NULL_EIGENVALUE * max(float(values[-1]), 1e-300)])


def field_form(model: ErrorModel, scale: Array, tool_offsets: Array, aligned: bool) -> Array:
    """Return the quadratic form (p, p) in mm² of the p model parameters that gives the mean square of the error field
    over the workspace and all tools.

    Parameters are in units of `scale` (p,). If `aligned` is True, the best-fitting rigid motion common to all tools is
    removed.
    """
    x, y, z = model.field_degrees
    grid = evaluation_grid(model.ranges_mm, (x + 4, y + 4, z + 4))
    offsets = np.atleast_2d(tool_offsets)
    basis = np.concatenate([deviation_basis(model, grid, offset) * scale for offset in offsets])
    flat = basis.reshape(-1, model.size)
    form = flat.T @ flat
    if aligned:
        points = np.concatenate([grid + offset for offset in offsets])
        motions = rigid_fields(points, points.mean(axis=0), float(np.ptp(points, axis=0).max())).reshape(-1, 6)
        # remove the best rigid motion G: FᵀF - FᵀG (GᵀG)⁻¹ GᵀF
        shared = motions.T @ flat
        form -= shared.T @ np.linalg.solve(motions.T @ motions, shared)
    return np.asarray(form / len(basis))


def summary(directions: Sequence[NullDirection]) -> tuple[str, ...]:
    """Return a description of null directions, with one line for each kind, such as `EBY[1..5]: not seen with one
    straight probe along Y`."""
    groups: dict[tuple[str, ...], list[NullDirection]] = {}
    for direction in directions:
        key = (*(name.split("[")[0] for name in direction.loadings), direction.circumstance)
        groups.setdefault(key, []).append(direction)
    return tuple(_group_text(members) for members in groups.values())


def join_names(names: Sequence[str]) -> str:
    """Return the names joined in a phrase: `EXX`, `EXX and EYY`, or `EXX, EYY and EZZ`."""
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))


def _directions(
    model: ErrorModel, null: Array, scale: Array, tool_offsets: Array, observer: str
) -> tuple[NullDirection, ...]:
    if null.shape[1] == 0:
        return ()
    form = field_form(model, np.where(scale > 0.0, scale, 1.0), tool_offsets, aligned=True)
    largest = float(np.linalg.eigvalsh(form)[-1])
    found = []
    for pivot, direction in _sparse_basis(null):
        parts = _parts(direction, pivot)
        changes = bool(direction @ form @ direction > _FIELD_NULL * largest) and bool(scale[pivot] > 0.0)
        names = [model.names[part] for part in parts]
        loadings = {model.names[part]: float(direction[part] * scale[part]) for part in parts}
        circumstance = _circumstance(tool_offsets, observer, changes) if scale[pivot] > 0.0 else FIXED
        found.append((pivot, NullDirection(_text(names, circumstance), loadings, changes, circumstance)))
    return tuple(direction for _, direction in sorted(found, key=lambda pair: pair[0]))


def _parts(direction: Array, pivot: int) -> list[int]:
    """Return the index of the pivot parameter, followed by the other parameters involved. The others are in the order
    of the model or, if there are many, in the order of decreasing loading."""
    size = np.abs(direction)
    others = [int(part) for part in np.flatnonzero(size > _MIN_LOADING * size.max()) if part != pivot]
    if len(others) > _MAX_PARTNERS:
        others.sort(key=lambda part: -size[part])
    return [pivot, *others]


def _sparse_basis(null: Array) -> list[tuple[int, Array]]:
    """Return a basis of the null space as pairs of a pivot parameter and a direction. The basis is found by
    Gauss-Jordan elimination with full pivoting. Each pivot occurs in one direction only."""
    rows = null.T.copy()
    pivots: list[int] = []
    for row in range(len(rows)):
        rest = np.abs(rows[row:])
        at, pivot = divmod(int(rest.argmax()), rest.shape[1])
        rows[[row, row + at]] = rows[[row + at, row]]
        rows[row] /= rows[row, pivot]
        others = np.arange(len(rows)) != row
        rows[others] -= np.multiply.outer(rows[others, pivot], rows[row])
        pivots.append(pivot)
    return list(zip(pivots, rows, strict=True))


def _circumstance(tool_offsets: Array, observer: str, changes: bool) -> str:
    if changes:
        return observer
    if len(tool_offsets) > 1:
        return f"with these {len(tool_offsets)} tools"
    along = np.flatnonzero(tool_offsets[0])
    if along.size == 1:
        return f"with one straight probe along {AXES[int(along[0])]}"
    return "with one tool offset"


def _text(names: list[str], circumstance: str) -> str:
    if len(names) == 1:
        return f"{names[0]}: not seen {circumstance}"
    if len(names) > 1 + _MAX_PARTNERS:
        leading = ", ".join(names[1 : 1 + _MAX_PARTNERS])
        return f"{names[0]} mixed with {len(names) - 1} others, most of all {leading}: not told apart {circumstance}"
    return f"{names[0]} merges with {join_names(names[1:])}: not told apart {circumstance}"


def _group_text(members: list[NullDirection]) -> str:
    columns = zip(*(direction.loadings for direction in members), strict=True)
    names = [_orders(list(column)) for column in columns]
    return _text(names, members[0].circumstance)


def _orders(names: list[str]) -> str:
    """Return `EBY[1..5]` for `EBY[1]`, …, `EBY[5]`."""
    error, bracket, _ = names[0].partition("[")
    orders = list(dict.fromkeys(name[len(error) + 1 : -1] for name in names))
    if not bracket or len(orders) == 1:
        return names[0]
    numbers = [int(order) for order in orders if order.isdigit()]
    if len(numbers) == len(orders) and numbers == list(range(numbers[0], numbers[0] + len(numbers))):
        return f"{error}[{numbers[0]}..{numbers[-1]}]"
    return f"{error}[{','.join(orders)}]"
