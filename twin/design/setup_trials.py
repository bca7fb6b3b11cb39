"""What would show more: a probe of another length, a lateral stylus, further positions, or the same once more."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from twin.arrays import Array
from twin.artefact.position_set import POSITION_SETS, Position
from twin.design.identifiability import EvaluatedTool, Identifiability, assess_identifiability
from twin.design.measurement_setup import SetUp, shortest_reach_mm
from twin.machine.kinematic_chain import AXES
from twin.machine.volumetric import QuadraticForm

LENGTHS_MM = (200.0, 100.0, -100.0, -200.0)
ACROSS_MM = (100.0, -100.0)
_SAME_TOOL_MM = 1.0


@dataclass(frozen=True, eq=False)
class TrialTool:
    """A tool that is not there: `offset` (3,) mm, `by_mm` longer than the first one, or `by_mm` aside along `axis`."""

    offset: Array
    by_mm: float
    axis: int
    lateral: bool

    @property
    def name(self) -> str:
        if self.lateral:
            return f"lateral {self.by_mm:+g} mm {AXES[self.axis]}"
        return f"{abs(self.by_mm):g} mm {'longer' if self.by_mm > 0.0 else 'shorter'}"


@dataclass(frozen=True, eq=False)
class SetUpTrial:
    """A set-up with something added: what the first tool measures again with `tool`, the positions of a set (`added`
    its name), or neither: the same positions once more."""

    set_up: SetUp
    tool: TrialTool | None = None
    added: str = ""

    @property
    def kind(self) -> str:
        """The same for trials of which one is enough."""
        if self.tool is None:
            return self.added or "again"
        return f"lateral {AXES[self.tool.axis]}" if self.tool.lateral else "length"


@dataclass(frozen=True, eq=False)
class TrialGain:
    """What a trial sees with `positions` more that have balls within reach, against what the set-up itself sees."""

    trial: SetUpTrial
    before: Identifiability
    after: Identifiability
    positions: int

    @property
    def rank(self) -> int:
        """Parameters more than before."""
        return self.after.rank - self.before.rank

    @property
    def shown(self) -> tuple[str, ...]:
        """Names of error motions, squareness and cross-effect that some null direction held before, and none after."""
        hidden = _hidden(self.after)
        return tuple(name for name in _hidden(self.before) if name not in hidden)

    @property
    def unseen_removed_mm(self) -> float:
        """Rms over workspace and viewpoints."""
        return self.before.unseen_mm - self.after.unseen_mm


def other_tools(set_up: SetUp) -> tuple[TrialTool, ...]:
    """Lengths and lateral styli worth a look; no probe shorter than its stem and body, none that is there already."""
    axis = set_up.tool_axis
    lengths = [_other(set_up, axis, by_mm, lateral=False) for by_mm in LENGTHS_MM]
    across = [k for k in range(3) if k != axis]
    lateral = [_other(set_up, k, by_mm, lateral=True) for k in across for by_mm in ACROSS_MM]
    probe = set_up.procedure.layout().probe
    there = set_up.procedure.tool_offsets
    return tuple(
        tool
        for tool in (*lengths, *lateral)
        if (tool.lateral or probe.reach_mm + tool.by_mm >= shortest_reach_mm(probe))
        and float(np.abs(there - tool.offset).max(axis=1).min()) > _SAME_TOOL_MM
    )


def evaluated_tools(set_up: SetUp, grid: Array) -> tuple[EvaluatedTool, ...]:
    """Where to look from: the tools of the set-up, the longest other one, and a lateral stylus for each direction."""
    used = {position.tool or set_up.first_tool for position in set_up.positions}
    own = [(name, layout.tool_offset_mm, name in used) for name, layout in set_up.procedure.layouts.items()]
    others: dict[int, TrialTool] = {}
    for tool in other_tools(set_up):
        others.setdefault(tool.axis, tool)
    every = [*own, *((tool.name, tool.offset, False) for tool in others.values())]
    model = set_up.model
    return tuple(EvaluatedTool(name, QuadraticForm.build(model, grid, offset), used) for name, offset, used in every)


def possible_trials(set_up: SetUp) -> Iterator[SetUpTrial]:
    """Everything that is worth a try."""
    for tool in other_tools(set_up):
        yield SetUpTrial(set_up.with_tool(tool.name, tool.offset), tool=tool)
    for name in POSITION_SETS:
        further = _further(set_up, name)
        if further:
            yield SetUpTrial(set_up.with_positions(further), added=name)
    yield SetUpTrial(set_up.with_positions(set_up.positions))


def trial_gains(set_up: SetUp, before: Identifiability, views: Sequence[EvaluatedTool]) -> tuple[TrialGain, ...]:
    """What each trial brings, the most of the unseen field first; those that reach no further ball are left out.

    `before`: what the set-up itself sees at `views`.
    """
    measured = len(set_up.plan().positions)
    found = []
    for trial in possible_trials(set_up):
        more = len(trial.set_up.plan().positions) - measured
        if more > 0:
            found.append(TrialGain(trial, before, assess_identifiability(trial.set_up.estimate(), views), more))
    return tuple(sorted(found, key=lambda gain: -gain.unseen_removed_mm))


def _hidden(seen: Identifiability) -> tuple[str, ...]:
    """What takes part in a null direction, in the model's order: EBY for EBY[1], EBY[2], …"""
    names = {name for direction in seen.null_directions for name in direction.loadings}
    return tuple(dict.fromkeys(p.error for p in seen.model.parameters if p.name in names))


def _other(set_up: SetUp, axis: int, by_mm: float, lateral: bool) -> TrialTool:
    offset = set_up.procedure.layout().tool_offset_mm.copy()
    backwards = not lateral and offset[axis] < 0.0
    offset[axis] += -by_mm if backwards else by_mm
    return TrialTool(offset, by_mm, axis, lateral)


def _further(set_up: SetUp, name: str) -> tuple[Position, ...]:
    """Positions of a named set, at the stations of the set-up, that the first tool does not measure yet."""
    there = {(p.station, p.azimuth_deg, p.elevation_deg) for p in set_up.first_positions()}
    stations = sorted({station for station, _, _ in there})
    wanted = [(station, *orientation) for station in stations for orientation in POSITION_SETS[name]]
    return tuple(Position(*place) for place in wanted if place not in there)
