"""Repeatability and lost motion of the axes, as the run of an estimate has measured them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from agent.execution.journal_reader import has_journal, open_journal
from agent.execution.journal_rows import DecisionRow
from drivers.errors import InputError
from twin.machine.kinematic_chain import AXES
from twin.units import UM_PER_MM
from twin.workpiece.positioning import FEWEST_FREEDOM, TITLES, AxisRepeats

_REVERSAL, _REPEATABILITY = "/reversal/reversal", "/repeatability"
"""Ends of the names of the two decisions of a run."""

_WHY: Mapping[tuple[bool, bool], str] = {
    (True, False): "its lost motion (settings `[reversal]`)",
    (False, True): "how well touches repeat (4 touches or more, settings `[probe_check]`)",
    (True, True): "its lost motion (settings `[reversal]`) and how well touches repeat (4 touches or more, settings "
    "`[probe_check]`)",
}
"""What was not measured, by whether the lost motion and the repeatability are missing."""


@dataclass(frozen=True)
class MeasuredRepeats:
    """Measurements of a run by the letter of the axis, and texts on what was not measured."""

    axes: Mapping[str, AxisRepeats]
    not_measured: tuple[str, ...]


def measured_repeats(estimate: Path) -> MeasuredRepeats:
    """Return what the run of an estimate has measured. `estimate` is the folder of a run, or a file in it; the journal
    beside this folder contains the measurements. An estimate that is not that of a run has none.

    Raises InputError if the journal cannot be read.
    """
    folder = (estimate if estimate.is_dir() else estimate.parent).resolve()
    decisions = _decisions(folder)
    if decisions is None:
        return MeasuredRepeats({}, (f"not measured: {', '.join(TITLES)}: the estimate is not in the folder of a run",))
    return repeats_of(decisions)


def repeats_of(rows: Iterable[DecisionRow]) -> MeasuredRepeats:
    """Return what the decisions of a run say about lost motion and repeatability."""
    decisions: dict[str, Mapping[str, Any]] = {}
    for row in rows:
        for end in (_REVERSAL, _REPEATABILITY):
            if row.kind.endswith(end):
                decisions[end] = row.record
    reversal = decisions.get(_REVERSAL, {})
    of_axis = {one["axis"]: one for one in reversal.get("axes", ())}
    axes = {
        name: _axis_repeats(of_axis.get(name, {}), reversal.get("at_mm"), decisions.get(_REPEATABILITY), number)
        for number, name in enumerate(AXES)
    }
    return MeasuredRepeats(axes, tuple(filter(None, (_missing(name, one) for name, one in axes.items()))))


def _decisions(folder: Path) -> tuple[DecisionRow, ...] | None:
    """Return the decisions of the run in `folder`; None if there is no run."""
    if not has_journal(folder.parent):
        return None
    with open_journal(folder.parent) as reader:
        try:
            run = reader.require_run(folder.name).run
        except InputError:
            return None
        return reader.decisions(run)


def _axis_repeats(
    reversal: Mapping[str, Any], at_mm: list[float] | None, repeatability: Mapping[str, Any] | None, number: int
) -> AxisRepeats:
    lost_um, sigma_um = reversal.get("lost_um"), reversal.get("sigma_um")
    scatter_um, freedom = reversal.get("scatter_um"), reversal.get("freedom", 0)
    if scatter_um is None or freedom < FEWEST_FREEDOM:
        scatter_um, freedom = _pooled(0.0 if scatter_um is None else scatter_um, freedom, repeatability)
    return AxisRepeats(
        scatter_mm=scatter_um / UM_PER_MM if freedom >= FEWEST_FREEDOM else None,
        freedom=freedom,
        lost_mm=None if lost_um is None else lost_um / UM_PER_MM,
        lost_sigma_mm=0.0 if sigma_um is None else sigma_um / UM_PER_MM,
        at_mm=0.0 if at_mm is None else at_mm[number],
    )


def _pooled(scatter_um: float, freedom: int, repeatability: Mapping[str, Any] | None) -> tuple[float, int]:
    """Return the scatter in µm of the touches of an axis and of those of a pole together, with its degrees of freedom.
    The touches of a pole, along the stylus, stand for all axes."""
    if repeatability is None or repeatability["touches"] < 2:
        return scatter_um, freedom
    of_pole_um, of_pole = 0.5 * repeatability["two_sigma_um"], repeatability["touches"] - 1
    both = freedom + of_pole
    return math.sqrt((freedom * scatter_um**2 + of_pole * of_pole_um**2) / both), both


def _missing(axis: str, found: AxisRepeats) -> str:
    """Return which figures of an axis cannot be stated and why; empty if all can be."""
    missing = ", ".join(f"{name} {axis}" for name in TITLES if name not in found.figures)
    if not missing:
        return ""
    return f"not measured: {missing}: the run did not measure {_WHY[found.lost_mm is None, found.scatter_mm is None]}"
