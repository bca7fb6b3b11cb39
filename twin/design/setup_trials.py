"""Trial changes of a measuring set-up: a different probe length, a lateral stylus, more positions, or repetition of all
positions. Each change could reveal further errors of the machine."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from twin.arrays import Array
from twin.artefact.position_set import POSITION_SETS, Position, set_orientations
from twin.design.identifiability import EvaluatedTool, Identifiability, assess_identifiability
from twin.design.measurement_setup import SetUp, shortest_reach_mm
from twin.machine.kinematic_chain import AXES
from twin.machine.volumetric import QuadraticForm

# A rotation shows as its angle times the lever: with 100 mm more, 10 µrad displace the tip by 1 µm more.
LENGTHS_MM = (200.0, 100.0, -100.0, -200.0)
ACROSS_MM = (100.0, -100.0)
_SAME_TOOL_MM = 1.0


@dataclass(frozen=True, eq=False)
class TrialTool:
    """Hypothetical tool with the offset `offset` (3,) in mm.

    If `lateral` is False, the tool is `by_mm` longer than the first tool of the set-up. If `lateral` is True, its tip
    is displaced from the tip of this first tool by `by_mm` along the machine axis with the index `axis`.
    """

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
    """Set-up with additional measurements. If `tool` is given, the positions of the first tool of the set-up are
    measured again with `tool`. If `added` names a position set, the positions of this set are added. If neither is
    given, all positions are measured again."""

    set_up: SetUp
    tool: TrialTool | None = None
    added: str = ""

    @property
    def kind(self) -> str:
        """Key that is the same for similar trials. Only one trial of each kind needs to be proposed."""
        if self.tool is None:
            return self.added or "again"
        return f"lateral {AXES[self.tool.axis]}" if self.tool.lateral else "length"


@dataclass(frozen=True, eq=False)
class TrialGain:
    """Comparison of the identifiability of a machine's parameters before and after a trial.

    `before` is the identifiability by the original set-up, and `after` is the identifiability by the set-up of the
    trial. `positions` is the number of added positions that can be measured.
    """

    trial: SetUpTrial
    before: Identifiability
    after: Identifiability
    positions: int

    @property
    def rank(self) -> int:
        """Number of parameter combinations that the measurements of the trial determine in addition to those that the
        original set-up determines."""
        return self.after.rank - self.before.rank

    @property
    def revealed(self) -> tuple[str, ...]:
        """Names of the errors (error motions, squareness, cross-effect) that take part in a null direction before the
        trial, but in no null direction after it."""
        hidden = _hidden_errors(self.after)
        return tuple(name for name in _hidden_errors(self.before) if name not in hidden)

    @property
    def unseen_removed_mm(self) -> float:
        """Decrease, by the trial, of the rms in mm of the unseen field over the workspace and the evaluated tools."""
        return self.before.unseen_mm - self.after.unseen_mm


def other_tools(set_up: SetUp) -> tuple[TrialTool, ...]:
    """Return the hypothetical tools worth trying as an addition to `set_up`: probes of other lengths and lateral styli.
    A tool is omitted if the set-up already has it. A probe is omitted if it is shorter than its stem and body together.
    """
    axis = set_up.tool_axis
    lengths = [_trial_tool(set_up, axis, by_mm, lateral=False) for by_mm in LENGTHS_MM]
    across = [k for k in range(3) if k != axis]
    lateral = [_trial_tool(set_up, k, by_mm, lateral=True) for k in across for by_mm in ACROSS_MM]
    probe = set_up.procedure.layout().probe
    there = set_up.procedure.tool_offsets
    return tuple(
        tool
        for tool in (*lengths, *lateral)
        if (tool.lateral or probe.reach_mm + tool.by_mm >= shortest_reach_mm(probe))
        and float(np.abs(there - tool.offset).max(axis=1).min()) > _SAME_TOOL_MM
    )


def evaluated_tools(set_up: SetUp, grid: Array) -> tuple[EvaluatedTool, ...]:
    """Return the tools for which the error field over `grid` is evaluated.

    These are the tools of the set-up and some trial tools: the first trial tool of a different length, and the first
    trial tool with a lateral stylus along each of the two machine axes perpendicular to the probe.
    """
    used = {position.tool or set_up.first_tool for position in set_up.positions}
    own = [(name, layout.tool_offset_mm, name in used) for name, layout in set_up.procedure.layouts.items()]
    others: dict[int, TrialTool] = {}
    for tool in other_tools(set_up):
        others.setdefault(tool.axis, tool)
    every = [*own, *((tool.name, tool.offset, False) for tool in others.values())]
    model = set_up.model
    return tuple(EvaluatedTool(name, QuadraticForm.build(model, grid, offset), used) for name, offset, used in every)


def possible_trials(set_up: SetUp) -> Iterator[SetUpTrial]:
    """Yield all trials (changes of `set_up`) worth evaluating: each hypothetical tool, each position set with new
    positions, and repetition of all positions of the set-up."""
    for tool in other_tools(set_up):
        yield SetUpTrial(set_up.with_tool(tool.name, tool.offset), tool=tool)
    for name in POSITION_SETS:
        further = _new_positions(set_up, name)
        if further:
            yield SetUpTrial(set_up.with_positions(further), added=name)
    yield SetUpTrial(set_up.with_positions(set_up.positions))


def trial_gains(set_up: SetUp, before: Identifiability, views: Sequence[EvaluatedTool]) -> tuple[TrialGain, ...]:
    """Return the gains of all trial changes of `set_up`, sorted by the decrease of the unseen field, the largest
    decrease first. Trials that add no measurable position are omitted.

    `before` is the identifiability by the original set-up, evaluated for the tools `views`.
    """
    measured = len(set_up.plan().positions)
    found = []
    for trial in possible_trials(set_up):
        more = len(trial.set_up.plan().positions) - measured
        if more > 0:
            found.append(TrialGain(trial, before, assess_identifiability(trial.set_up.estimate(), views), more))
    return tuple(sorted(found, key=lambda gain: -gain.unseen_removed_mm))


def _hidden_errors(seen: Identifiability) -> tuple[str, ...]:
    """Return the errors that take part in a null direction, in the order of the model. A coefficient such as EBY[1]
    counts as its error, EBY."""
    names = {name for direction in seen.null_directions for name in direction.loadings}
    return tuple(dict.fromkeys(p.error for p in seen.model.parameters if p.name in names))


def _trial_tool(set_up: SetUp, axis: int, by_mm: float, lateral: bool) -> TrialTool:
    offset = set_up.procedure.layout().tool_offset_mm.copy()
    # a longer probe moves the tip away from the ram, which is the negative direction if the offset is negative
    backwards = not lateral and offset[axis] < 0.0
    offset[axis] += -by_mm if backwards else by_mm
    return TrialTool(offset, by_mm, axis, lateral)


def _new_positions(set_up: SetUp, name: str) -> tuple[Position, ...]:
    """Return the positions of the set called `name` at the stations of the set-up. Positions already measured with the
    first tool are omitted."""
    there = {(p.station, p.azimuth_deg, p.elevation_deg) for p in set_up.first_positions()}
    stations = sorted({station for station, _, _ in there})
    orientations = set_orientations(name, set_up.procedure.layout().frame.facing_deg)
    wanted = [(station, *orientation) for station in stations for orientation in orientations]
    return tuple(Position(*key) for key in wanted if key not in there)
