"""Corrections that a controller applies if it misreads a compensation table that it has stored.

A table reaches a controller as a long list of integers. Whether they act on the right axis, at the right place, with
the right sign and amount depends on the program of the controller, which a read-back of the stored integers cannot
show: it returns them in the order in which they were written.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np

from twin.arrays import Array
from twin.compensation.table import CompensationTable
from twin.machine.kinematic_chain import AXES

_IN_ORDER = (0, 1, 2)
_QUARTERS = (1, 2, 3)


NO_EFFECT = "the table has no effect: the controller stores it, but does not apply it"


@dataclass(frozen=True, eq=False)
class MisreadTable:
    """Table with the corrections that a controller applies by mistake. `mistake` names the mistake and what to check at
    the controller."""

    mistake: str
    table: CompensationTable


def misread_tables(table: CompensationTable) -> Iterator[MisreadTable]:
    """Yield the tables that a controller may apply by mistake in place of `table`: none, with another sign or amount,
    with the axes exchanged, with the nodes in another order or moved by one node, or a part of it."""
    for mistake, corrections in _misread(table.corrections):
        yield MisreadTable(mistake, replace(table, corrections=np.ascontiguousarray(corrections)))


def _misread(corrections: Array) -> Iterator[tuple[str, Array]]:
    yield NO_EFFECT, np.zeros_like(corrections)
    yield (
        "the correction acts the wrong way: check the sign with which the controller adds the table",
        -corrections,
    )
    yield (
        "half of each correction acts: check the unit and the scale of the table at the controller, and whether an "
        "axis is programmed in diameters",
        0.5 * corrections,
    )
    yield (
        "twice the correction acts: check the unit and the scale of the table at the controller, and whether the "
        "table is added in two places",
        2.0 * corrections,
    )
    yield from _components_misread(corrections)
    yield from _nodes_misread(corrections)
    yield from _parts(corrections)


def _components_misread(corrections: Array) -> Iterator[tuple[str, Array]]:
    for order in permutations(_IN_ORDER):
        if order != _IN_ORDER:
            pairs = ", ".join(f"the correction of {AXES[order[k]]} on {AXES[k]}" for k in _IN_ORDER if order[k] != k)
            yield f"the axes are exchanged: {pairs}", corrections[..., list(order)]
    for k, axis in enumerate(AXES):
        for factor, mistake in (
            (-1.0, "acts the wrong way: check its sign at the controller"),
            (0.0, "does not act: check that the compensation of this axis is switched on"),
        ):
            factors = np.ones(3)
            factors[k] = factor
            yield f"the correction of {axis} {mistake}", corrections * factors


def _nodes_misread(corrections: Array) -> Iterator[tuple[str, Array]]:
    shape = corrections.shape[:3]
    listed = corrections.reshape(-1, 3)
    for order in permutations(_IN_ORDER):
        if order != _IN_ORDER:
            # the list is written with x slowest and z fastest, and read with `order` from the slowest to the fastest
            read = listed.reshape(*(shape[k] for k in order), 3)
            names = ", then ".join(AXES[k] for k in reversed(order))
            yield (
                f"the nodes are read in another order: {names}, the fastest first, and not Z, then Y, then X",
                read.transpose(*np.argsort(order), 3),
            )
    yield (
        "the corrections are read axis by axis, and not node by node",
        np.moveaxis(corrections.reshape(3, *shape), 0, 3),
    )
    for k, axis in enumerate(AXES):
        yield f"the nodes are read in the opposite direction along {axis}", np.flip(corrections, k)
        for step, where in ((1, "below"), (-1, "above")):
            taken = np.clip(np.arange(shape[k]) + step, 0, shape[k] - 1)
            yield f"the corrections act one node {where} their own along {axis}", np.take(corrections, taken, axis=k)


def _parts(corrections: Array) -> Iterator[tuple[str, Array]]:
    for quarters in _QUARTERS:
        kept = np.zeros(len(listed := corrections.reshape(-1, 3)), dtype=bool)
        kept[: len(listed) * quarters // 4] = True
        for which, part in (("first", kept), ("last", kept[::-1])):
            yield (
                f"only about the {which} {quarters} quarters of the nodes act, and the others are zero"
                if quarters > 1
                else f"only about the {which} quarter of the nodes acts, and the others are zero",
                np.where(part[:, None], listed, 0.0).reshape(corrections.shape),
            )
