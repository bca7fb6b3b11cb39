"""Input and result of a study."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import TypeVar

from agent.figures.heading import subject
from agent.figures.style import Draw, headed
from agent.model_files import load_positions
from agent.planning.design.design_result import Prove
from agent.planning.job import Job
from agent.settings.load import POSITION_FILES
from agent.settings.schema import RELOCATION_BY_HAND_MINUTES
from agent.studies import STUDIES
from agent.studies.true_effects import StatedEffect, with_effects
from agent.studies.workers import Workers
from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.position_set import Position, parse_position_set
from twin.artefact.touch_pattern import approach_directions
from twin.design.procedure import Procedure
from twin.identification import Options
from twin.machine.machine_description import MachineDescription
from twin.uncertainty.truth_assumptions import TruthAssumptions

Item = TypeVar("Item")
Result = TypeVar("Result")
Cell = str | int | float | bool | None

NAME_COLUMNS = ("machine_name", "artefact_name")
"""Last columns of the table of each study."""
_FACTS_OF_MACHINE = ("machine", "artefact", "balls", "stations")

SIMULATED_OPERATOR = "simulated-operator"
"""Driver of an operator who is simulated."""

Progress = Callable[[str, int, int], None]
"""Callback that takes the current activity, the number of finished items, and the total number of items."""


@dataclass(frozen=True, eq=False)
class StudyCase:
    """Input of a study.

    `options` contains the identification options, and `machines` is the number of random machines to simulate.
    `prove` carries out the preflight of a calibration of a designed position set. `position_set` is the value of the
    command-line option `--set`, or None if the position set of the settings is used. `effects` act on the true machines
    and their measurement, and no identification knows them. `true_machine` describes the true machines; if it is None,
    they are those of the machine that is identified.
    """

    job: Job
    options: Options
    seed: int
    machines: int
    workers: Workers
    progress: Progress
    prove: Prove
    position_set: str | None = None
    effects: tuple[StatedEffect, ...] = ()
    true_machine: MachineDescription | None = None

    @property
    def machine(self) -> MachineDescription:
        return self.job.machine

    @property
    def artefact(self) -> Artefact:
        return self.job.artefact

    @property
    def procedure(self) -> Procedure:
        return self.job.procedure

    @property
    def tool_offset(self) -> Array:
        """Tool offset (3,) in mm, from the reference point of the ram to the stylus centre."""
        return self.job.tool_offset_mm

    @property
    def assumptions(self) -> TruthAssumptions:
        """Assumptions about the true conditions of the measurement. The simulated machines are drawn from the family
        that the machine file of the true machines describes, and have the deflection given in this file.
        """
        return self.with_stated_effects(TruthAssumptions.of_case(self.true_machine or self.machine))

    def with_stated_effects(self, assumptions: TruthAssumptions) -> TruthAssumptions:
        """Return the assumptions with the stated effects added."""
        if not self.effects:
            return assumptions
        count = self.job.settings.procedure.touches_per_ball
        touched = [approach_directions(count, one.frame.stylus_axis) for one in self.procedure.layouts.values()]
        return with_effects(assumptions, self.effects, touched)

    def positions(self, expression: str | None = None) -> tuple[Position, ...]:
        """Return the measuring positions that `expression` describes.

        An expression is either a combination of named sets, such as `S1` or `S1+S3`, or the path of a position file.
        Named sets are measured at the stations of the case. If `expression` is None, the position set of the case is
        used. Raises TwinError for an unknown set, and UserError for an invalid file.
        """
        expression = expression or self.position_set
        if expression is None:
            return self.job.positions
        if expression.endswith(POSITION_FILES):
            return load_positions(Path(expression))
        return tuple(
            position
            for position in parse_position_set(expression, max(self.stations), self.job.layout.frame.facing_deg)
            if position.station in self.stations
        )

    @property
    def stations(self) -> tuple[int, ...]:
        """Numbers of the stations at which named position sets, such as S1, are measured."""
        return tuple(self.job.settings.procedure.stations or self.procedure.stations)

    @property
    def relocation_minutes(self) -> float:
        """Minutes to carry the artefact to another station.

        They are those of the settings, even if 0. A simulated operator who takes no time is replaced by a person
        without a crane, so that sets at different numbers of stations can be compared.
        """
        settings = self.job.settings
        operator = settings.devices.get(settings.roles.operator)
        if settings.timing.relocation_minutes == 0.0 and operator is not None and operator.driver == SIMULATED_OPERATOR:
            return RELOCATION_BY_HAND_MINUTES
        return settings.timing.relocation_minutes

    def map(self, task: Callable[[Item], Result], items: Sequence[Item], what: str = "machines") -> list[Result]:
        """Apply `task` to all items with the workers of the study, and return the results in the order of the items.
        `what` is the label of the progress display.
        """
        total = len(items)
        self.progress(what, 0, total)
        return self.workers.map(task, items, lambda done: self.progress(what, done, total))

    @property
    def heading(self) -> str:
        """Line that names machine and artefact, and how the true machines differ from what is identified."""
        return subject(self.machine.name, self.artefact.name) + self.differences

    @property
    def differences(self) -> str:
        """Text that follows the names of the machines if the true machines differ from the identified ones."""
        other = f", true machines: {self.true_machine.name}" if self.true_machine else ""
        return other + (f", with {', '.join(map(str, self.effects))}" if self.effects else "")

    @property
    def facts(self) -> dict[str, object]:
        """Conditions of the study by name, such as machine, artefact and seed. They are added to the summary of its
        result.
        """
        return {
            "machine": self.machine.name,
            "artefact": self.artefact.name,
            "balls": self.artefact.count,
            "stations": len(self.stations),
            "set": self.position_set or self.job.settings.procedure.position_set,
            "formulation": self.options.formulation if self.options.cut_off is None else "published",
            "prior": self.options.use_prior,
            "weights": self.options.weights,
            "cut_off": self.options.cut_off,
            "machines": self.machines,
            "seed": self.seed,
            **({"with": [str(one) for one in self.effects]} if self.effects else {}),
            **({"true_machine": self.true_machine.name} if self.true_machine else {}),
        }


@dataclass(frozen=True, eq=False)
class StudyResult:
    """Result of a study.

    `columns` (the names with units) and `rows` form a table. `summary` contains values that `agent.studies.study_files`
    can write as JSON. `draw` is a function that draws the result on an empty figure of `size_in` inches, in the style
    of `agent.figures.style`. `subjects` are pairs of the names of a machine and its artefact if the study itself
    chooses its machines; its rows then end with `NAME_COLUMNS`. It is empty if the result holds for the machine of the
    case.
    """

    name: str
    title: str
    columns: tuple[str, ...]
    rows: Sequence[Sequence[Cell]]
    summary: Mapping[str, object]
    draw: Draw
    size_in: tuple[float, float] = (7.0, 4.2)
    subjects: tuple[tuple[str, str], ...] = ()


def run_study(name: str, case: StudyCase) -> StudyResult:
    """Run the study called `name` and return its result, with the conditions of `case` added to the summary.

    The names of the machine and the artefact also head the figure and are the last two columns of the table. A study
    that chooses its machines names each of them instead.
    """
    module, _, attribute = STUDIES[name].partition(":")
    run: Callable[[StudyCase], StudyResult] = getattr(import_module(module), attribute)
    result = run(case)
    if result.subjects:
        common = {name: value for name, value in case.facts.items() if name not in _FACTS_OF_MACHINE}
        named = [{"machine": machine, "artefact": artefact} for machine, artefact in result.subjects]
        return replace(
            result,
            summary={**common, "subjects": named, **result.summary},
            draw=headed(result.draw, "; ".join(subject(*names) for names in result.subjects) + case.differences),
        )
    return replace(
        result,
        columns=(*result.columns, *NAME_COLUMNS),
        rows=[(*row, case.machine.name, case.artefact.name) for row in result.rows],
        summary={**case.facts, **result.summary},
        draw=headed(result.draw, case.heading),
    )
