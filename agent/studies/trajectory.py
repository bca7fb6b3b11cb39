"""Compensation along a line in Z. The study compares the deviation of one simulated machine with the deviations
predicted by models that were identified from simulated measurements of this machine.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agent.figures.style import BAND_OPACITY, INK, SERIES
from agent.planning.design.bar_variants import Bar
from agent.studies.identification_variants import IdentificationVariant, identification_variants
from agent.studies.measure import ALIGNED, AS_DEFINED
from agent.studies.monte_carlo import RefusedMachine
from agent.studies.procedure_value import ProcedureEvaluator, ProcedureVariant
from agent.studies.study import Cell, StudyCase, StudyResult
from agent.studies.workers import generator
from twin.arrays import Array
from twin.machine.error_model import Ranges
from twin.machine.kinematic_chain import AXES
from twin.uncertainty.error_budget import ErrorBudget
from twin.uncertainty.monte_carlo import draw_truth
from twin.uncertainty.residual_field_form import FieldForm

NAME = "trajectory"
COUNTS = (3, 5, 11)
POINTS = 151
COVERAGE_FACTOR = 2.0
LINE_STYLES = (":", "--", "-")


@dataclass(frozen=True, eq=False)
class TrajectoryResult:
    """Deviations at n points of a trajectory, as arrays (n, 3) in µm, either as defined or after the best-fitting rigid
    motion of the workspace is removed from all of them.

    `z_mm` (n,) contains the Z coordinates of the points. `machine_um` contains the true deviations of the simulated
    machine. `models_um` and `sigma_um` are mappings whose keys are numbers of balls on the measured bar. `models_um`
    gives the deviations predicted by the model that was identified with that number of balls. `sigma_um` gives the
    expected rms difference between the machine and that model for each point and direction. A number of balls is left
    out if the measurement of a bar with so many balls does not identify the machine.
    """

    z_mm: Array
    machine_um: Array
    models_um: dict[int, Array]
    sigma_um: dict[int, Array]

    def residual_um(self, count: int) -> float | None:
        """Return the rms length in µm, over the points of the trajectory, of the difference between the deviations of
        the machine and of the model that was identified with a bar of `count` balls. Return None if this bar does not
        identify the machine.
        """
        return _rms(self.machine_um - self.models_um[count]) if count in self.models_um else None

    def expected_residual_um(self, count: int) -> float | None:
        """Return the expected rms difference in µm, over the points of the trajectory, between the deviations of a
        machine of the assumed family and of the model that is identified with a bar of `count` balls. Return None if
        this bar does not identify the machine.
        """
        return _rms(self.sigma_um[count]) if count in self.sigma_um else None


def run(case: StudyCase) -> StudyResult:
    """Compare simulated machine number 0 with three models of it. The models are identified with bars of 3, 5 and 11
    balls, all measured in the position set of the study case.
    """
    variant, line = identification_variants(case.options)[0], middle_line(case.machine.model.ranges_mm)
    identified = IdentifiedModels.of(case, variant)
    followed, defined = identified.along(line, aligned=True), identified.along(line, aligned=False)
    where = f"X = {line[0, 0]:g} mm, Y = {line[0, 1]:g} mm"
    return StudyResult(
        name=NAME,
        title="Deviation along Z: machine and compensation model",
        columns=_columns(),
        rows=[[*left, *right[1:]] for left, right in zip(_rows(followed), _rows(defined), strict=True)],
        summary=_summary(followed, defined, line) | {"refusals": _keyed(identified.reasons)},
        draw=partial(_draw, both=(defined, followed), title=f"One machine at {where}; {variant.title}"),
        size_in=(10.0, 8.0),
    )


def middle_line(ranges_mm: Ranges) -> Array:
    """Return 151 axis positions (151, 3) in mm on a line parallel to Z. The line covers the full range of Z, with X and
    Y in the middle of their ranges.
    """
    x, y, z = ranges_mm
    line = np.tile([0.5 * sum(x), 0.5 * sum(y), 0.0], (POINTS, 1))
    line[:, 2] = np.linspace(*z, POINTS)
    return line


@dataclass(frozen=True, eq=False)
class IdentifiedModels:
    """True parameters of simulated machine number 0, and the parameters and error budget of each of its models by the
    number of balls. A number of balls that does not identify the machine is left out. `reasons` contains the messages
    of the identification for those that it refused."""

    field: FieldForm
    truth: Array
    models: dict[int, tuple[Array, ErrorBudget]]
    reasons: dict[int, str]

    @classmethod
    def of(cls, case: StudyCase, variant: IdentificationVariant) -> IdentifiedModels:
        """Identify the machine with bars of 3, 5 and 11 balls."""
        evaluator, bar, positions = ProcedureEvaluator(case), Bar.of(case.artefact), case.positions()
        models, reasons = dict[int, tuple[Array, ErrorBudget]](), dict[int, str]()
        for done, count in enumerate(COUNTS):
            case.progress("numbers of balls", done, len(COUNTS))
            trial = ProcedureVariant.of(case, bar.with_(balls=count), positions)
            budget = evaluator.budget(trial, variant)
            if budget is None:
                continue
            found = evaluator.procedure(trial, variant)(0)
            if isinstance(found, RefusedMachine):
                reasons[count] = found.reason
            else:
                models[count] = (found.estimate, budget)
        case.progress("numbers of balls", len(COUNTS), len(COUNTS))
        truth = draw_truth(case.assumptions, generator(case.seed, 0), case.tool_offset).parameters
        return cls(evaluator.field, truth, models, reasons)

    def along(self, line: Array, *, aligned: bool) -> TrajectoryResult:
        """Return the deviations at the n axis positions `line` (n, 3) in mm. If `aligned`, the best-fitting rigid
        motion of the workspace is removed."""
        basis, deflection = self.field.columns_at(line, aligned)
        found = self.models.items()
        return TrajectoryResult(
            line[:, 2],
            1e3 * (basis[:, :, self.field.true_indices] @ self.truth + deflection),
            {count: 1e3 * (basis[:, :, self.field.model_indices] @ estimate) for count, (estimate, _) in found},
            {count: 1e3 * budget.field_uncertainty(line, aligned) for count, (_, budget) in found},
        )


def _keyed(reasons: dict[int, str]) -> dict[str, str]:
    return {f"{count}_balls": reason for count, reason in reasons.items()}


def _rms(vectors: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))


def _columns() -> tuple[str, ...]:
    names = [f"machine_{axis}_um" for axis in AXES]
    for count in COUNTS:
        names += [f"{count}_balls_{axis}_um" for axis in AXES]
        names += [f"{count}_balls_expected_rms_{axis}_um" for axis in AXES]
    return ("z_mm", *names, *(f"as_defined_{name}" for name in names))


def _rows(followed: TrajectoryResult) -> list[list[Cell]]:
    parts = [followed.machine_um]
    for count in COUNTS:
        parts += [held.get(count, _missing_values(followed)) for held in (followed.models_um, followed.sigma_um)]
    table = np.column_stack([followed.z_mm, *parts])
    return [[None if np.isnan(value) else value for value in row] for row in table.tolist()]


def _missing_values(followed: TrajectoryResult) -> Array:
    return np.full_like(followed.machine_um, np.nan)


def _summary(followed: TrajectoryResult, defined: TrajectoryResult, line: Array) -> dict[str, object]:
    return {
        "machine_number": 0,
        "x_mm": float(line[0, 0]),
        "y_mm": float(line[0, 1]),
        "rms_before_um": _rms(followed.machine_um),
        "rms_left_um": {str(count): followed.residual_um(count) for count in COUNTS},
        "rms_left_expected_um": {str(count): followed.expected_residual_um(count) for count in COUNTS},
        "rms_before_as_defined_um": _rms(defined.machine_um),
        "rms_left_as_defined_um": {str(count): defined.residual_um(count) for count in COUNTS},
        "rms_left_expected_as_defined_um": {str(count): defined.expected_residual_um(count) for count in COUNTS},
        "not_identified": [count for count in COUNTS if count not in followed.models_um],
    }


def _draw(figure: Figure, both: tuple[TrajectoryResult, TrajectoryResult], title: str) -> None:
    panels = figure.subplots(2, 3, sharex=True, sharey="row")
    for row, followed, measure in zip(panels, both, (AS_DEFINED, ALIGNED), strict=True):
        for axis, panel in enumerate(row):
            _draw_direction(panel, followed, axis)
            panel.set_title(f"{AXES[axis]} direction, {measure.title}")
        row[0].set_ylabel(f"deviation, {measure.title} / µm")
    for panel in panels[-1]:
        panel.set_xlabel("Z / mm")
    figure.suptitle(title, fontsize=9.5)
    figure.legend(*_labels(panels[-1][0], *both), loc="outside lower center", ncols=2)


def _labels(panel: Axes, defined: TrajectoryResult, followed: TrajectoryResult) -> tuple[list[Artist], list[str]]:
    """Return the handles and labels of the legend; a label of a model gives the rms left in both measures."""
    handles, labels = panel.get_legend_handles_labels()
    named = {
        f"model C, {count} balls": (
            f"model C, {count} balls; rms left here {_shown(defined.residual_um(count))} µm as defined, "
            f"{_shown(followed.residual_um(count))} µm aligned"
        )
        for count in COUNTS
    }
    return handles, [named.get(label, label) for label in labels]


def _shown(value_um: float | None) -> str:
    return "-" if value_um is None else f"{value_um:.1f}"


def _draw_direction(panel: Axes, followed: TrajectoryResult, axis: int) -> None:
    z_mm = followed.z_mm
    panel.plot(z_mm, followed.machine_um[:, axis], color=INK, linewidth=2.6, label="machine M")
    for series, (count, model) in enumerate(followed.models_um.items()):
        panel.plot(z_mm, model[:, axis], LINE_STYLES[series], color=SERIES[series], label=f"model C, {count} balls")
    if COUNTS[-1] in followed.models_um:
        middle, reach = (
            followed.models_um[COUNTS[-1]][:, axis],
            COVERAGE_FACTOR * followed.sigma_um[COUNTS[-1]][:, axis],
        )
        band = f"C of {COUNTS[-1]} balls ± {COVERAGE_FACTOR:g} · expected rms"
        panel.fill_between(
            z_mm, middle - reach, middle + reach, color=SERIES[2], alpha=BAND_OPACITY, linewidth=0, label=band
        )
