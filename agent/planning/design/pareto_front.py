"""Pareto front of position sets: expected volumetric error after compensation against machine minutes."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.design.goals import MIN_POSITIONS
from twin.design.search import ExchangeSearch, Selection

FURTHEST = 24
"""Minimum number of positions of the largest set of a front."""


@dataclass(frozen=True)
class FrontPoint:
    """Evaluated set of positions, drawn as one point of the Pareto front.

    `positions` is the number of positions, and `vce_um` the expected volumetric error after compensation (VCE) in µm.
    `valuation` is the expected reduction of the volumetric error in percent. `best` is True if every faster set has a
    larger expected VCE. `design` is True for the set that was designed for the goal of the user.
    """

    positions: int
    minutes: float
    vce_um: float
    valuation: float
    best: bool
    design: bool


def front_of(search: ExchangeSearch, chosen: Sequence[int], minutes: float) -> tuple[FrontPoint, ...]:
    """Return one point for each evaluated set of positions and one for the designed set, sorted by machine minutes.

    The evaluated sets grow one position at a time: each set adds to the previous set the position that reduces the
    expected error most per minute. The designed set consists of the candidates of `search` with the indices `chosen`
    and takes `minutes`. Those of the evaluated sets are the minutes of their positions added.
    """
    candidates = search.candidates
    before = candidates.before.aligned_um
    furthest = max(FURTHEST, len(chosen))
    start = Selection.of(candidates)
    grown = search.grow(start, lambda taken: np.full(candidates.count, len(taken) < furthest), per_minute=True)
    points = [
        (len(one.chosen), search.costs.total(one.chosen), 1e3 * float(np.sqrt(one.value)), False)
        for one in grown
        if len(one.chosen) >= MIN_POSITIONS
    ]
    points.append((len(chosen), minutes, candidates.vce(chosen).aligned_um, True))
    points.sort(key=lambda point: (point[1], point[2]))
    lowest, front = np.inf, []
    for count, taken, vce, design in points:
        front.append(FrontPoint(count, taken, vce, 100.0 * (1.0 - vce / before), vce < lowest, design))
        lowest = min(lowest, vce)
    return tuple(front)


def grown_front(points: Sequence[FrontPoint]) -> list[FrontPoint]:
    """Return the points of the Pareto front without the designed set, whose minutes are determined otherwise."""
    return [point for point in points if point.best and not point.design]


def format_front(points: Sequence[FrontPoint], machine: str, artefact: str) -> str:
    """Return `points` as CSV text with one line per set of positions. The last two columns contain the names of the
    machine and the artefact."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    columns = ("positions", "machine_minutes", "expected_vce_aligned_um", "valuation_percent", "on_front", "design")
    writer.writerow((*columns, "machine_name", "artefact_name"))
    for p in points:
        words = ("yes" if p.best else "no", "yes" if p.design else "no")
        writer.writerow(
            (p.positions, f"{p.minutes:.3f}", f"{p.vce_um:.4f}", f"{p.valuation:.2f}", *words, machine, artefact)
        )
    return text.getvalue()
