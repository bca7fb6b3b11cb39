"""Monte Carlo simulation of whole procedures. It compares the volumetric error of many simulated machines before and
after compensation (VE and VCE) with the values computed in closed form.

Each machine is drawn, measured and identified independently of the others. It is identified twice from the same
measurements. The first identification is that of a run: it estimates scale factors for the uncertainties of noise,
prior and model misfit, and rejects balls that contradict the others. The second identification uses all uncertainties
as stated, as the closed form assumes.

The identification may refuse a machine, for example because the artefact seems to have moved. Such a machine is counted
and left out of the errors after compensation.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agent.errors import RunError
from agent.figures.style import BAND_OPACITY, BLUE, GREEN, INK, ORANGE, from_zero
from agent.studies.study import Cell, StudyCase, StudyResult
from agent.studies.workers import generator
from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.observations import Observations
from twin.errors import DataError, SingularSet
from twin.identification import Options, identify
from twin.machine.machine_population import Family
from twin.machine.volumetric import VolumetricRms, evaluation_grid
from twin.uncertainty.error_budget import error_budget_of_form
from twin.uncertainty.monte_carlo import compensated_errors, draw_truth, simulated_observations, uncompensated_errors
from twin.uncertainty.residual_field_form import FieldForm
from twin.uncertainty.truth_assumptions import TruthAssumptions
from twin.units import UM_PER_MM

NAME = "monte-carlo"
COVERAGE_FACTOR = 2.0


@dataclass(frozen=True)
class SimulatedMachine:
    """One simulated machine and its identification.

    `truth` contains the true parameters of the error model, and `estimate` the estimated ones. `chi2_normalised` is the
    normalised χ² of the estimate, and `rejected` is the number of rejected balls.
    """

    truth: Array
    estimate: Array
    chi2_normalised: float
    rejected: int


@dataclass(frozen=True)
class RefusedMachine:
    """Simulated machine whose measurement the identification refuses, as it would refuse the measurement of a run.

    `number` is the number of the machine, and `truth` contains the true parameters of the error model. `reason` is the
    message of the refusal. `undetermined` is True if the identification found no estimate, and False if it found that
    the measurements contradict each other, the artefact or the machine.
    """

    number: int
    truth: Array
    reason: str
    undetermined: bool


Outcome = SimulatedMachine | RefusedMachine
"""Result of the simulation of one machine."""


@dataclass(frozen=True, eq=False)
class ProcedureTask:
    """Task that draws the machine with a given number and simulates the measuring procedure and the identification on
    it.

    If assumptions and seed are the same, a given number stands for the same machine and artefact in all procedures.
    """

    planned: Observations
    artefact: Artefact
    family: Family
    assumptions: TruthAssumptions
    options: Options
    tool_offset: Array
    seed: int

    @classmethod
    def of(cls, case: StudyCase, planned: Observations, options: Options | None = None) -> ProcedureTask:
        """Return the task for the artefact and machines of `case`. If `options` is None, the identification options of
        `case` are used."""
        chosen = options or case.options
        family = case.machine.family
        return cls(planned, case.artefact, family, case.assumptions, chosen, case.tool_offset, case.seed)

    def check(self) -> None:
        """Identify the planned ball centres. Raises SingularSet if they do not determine a machine, because every
        simulated machine would then be refused."""
        identify(self.family.model, self.planned, self.artefact, self.family, self.options)

    def __call__(self, number: int) -> Outcome:
        rng = generator(self.seed, number)
        truth = draw_truth(self.assumptions, rng, self.tool_offset)
        seen = simulated_observations(self.planned, self.artefact, truth, self.assumptions, rng)
        try:
            found = identify(self.family.model, seen, self.artefact, self.family, self.options)
        except (DataError, SingularSet) as refusal:
            return RefusedMachine(number, truth.parameters, refusal.message, isinstance(refusal, SingularSet))
        return SimulatedMachine(truth.parameters, found.parameters, found.chi2_normalised, len(found.rejected))


@dataclass(frozen=True, eq=False)
class ErrorSample:
    """Volumetric errors in mm of a sample of machines, one value per machine in each array.

    `raw_mm` contains the errors without alignment; `aligned_mm` contains the errors after the best-fitting rigid motion
    is removed. `refused` is the number of further machines that the identification refused.
    """

    raw_mm: Array
    aligned_mm: Array
    refused: int = 0

    @classmethod
    def uncompensated(cls, form: FieldForm, machines: Sequence[Outcome]) -> ErrorSample:
        """Return the errors of all `machines` without compensation."""
        return cls(*uncompensated_errors(form, _truths(machines)))

    @classmethod
    def compensated(cls, form: FieldForm, machines: Sequence[Outcome]) -> ErrorSample:
        """Return the errors after compensation of those `machines` that were identified, of which there must be at
        least one."""
        found = identified(machines)
        errors = compensated_errors(form, _truths(found), np.array([machine.estimate for machine in found]))
        return cls(*errors, refused=len(machines) - len(found))

    @property
    def expected(self) -> VolumetricRms:
        """Root mean square of the volumetric errors over the machines. It is comparable with the prediction in closed
        form, which is the root of the expected mean square."""
        return VolumetricRms(*(float(np.sqrt(np.mean(values**2))) for values in (self.raw_mm, self.aligned_mm)))

    @property
    def standard_error(self) -> VolumetricRms:
        """Standard error of `expected`, propagated from the standard error of the mean square over the machines."""
        return VolumetricRms(*(_error_of_root(values) for values in (self.raw_mm, self.aligned_mm)))


def identified(machines: Sequence[Outcome]) -> list[SimulatedMachine]:
    """Return those `machines` that the identification did not refuse."""
    return [machine for machine in machines if isinstance(machine, SimulatedMachine)]


def refused(machines: Sequence[Outcome]) -> list[RefusedMachine]:
    """Return those `machines` that the identification refused."""
    return [machine for machine in machines if isinstance(machine, RefusedMachine)]


def mostly_refused(machines: Sequence[Outcome]) -> bool:
    """Return True if the identification refused more than half of `machines`; the others then represent nothing."""
    return 2 * len(refused(machines)) > len(machines)


def check_refusals(case: StudyCase, machines: Sequence[Outcome]) -> None:
    """Raise RunError if the identification refused more than half of `machines`. The message names the effects and the
    true machines that were stated, and the reason of the first refusal."""
    if not mostly_refused(machines):
        return
    found = refused(machines)
    hint = "use another position set, or other errors of the machine in its file"
    if case.differences:
        hint = "state smaller effects, or true machines that are more like the identified one"
    raise RunError(
        f"the identification refuses {len(found)} of {len(machines)} simulated machines{case.differences}, as it would "
        f"refuse such a run; machine {found[0].number}: {found[0].reason}",
        hint=hint,
    )


def run(case: StudyCase) -> StudyResult:
    """Simulate `case.machines` machines, measured in the position set of `case`, and compare their volumetric errors
    before and after compensation (VE and VCE) with the values computed in closed form."""
    planned = case.procedure.plan(case.positions()).observations
    grid = evaluation_grid(case.machine.model.ranges_mm)
    form = FieldForm.build(case.machine.model, case.assumptions, grid, case.tool_offset)
    stated = with_stated_scales(case.options)
    closed = error_budget_of_form(form, case.machine.family, case.artefact, planned, stated).expected
    numbers, as_stated = range(case.machines), ProcedureTask.of(case, planned, stated)
    as_stated.check()
    plain = case.map(as_stated, numbers, "machines, scales as stated")
    check_refusals(case, plain)
    usual = case.map(ProcedureTask.of(case, planned), numbers, "machines, as a run identifies")
    check_refusals(case, usual)
    found = SimulationComparison(
        closed,
        ErrorSample.uncompensated(form, plain),
        ErrorSample.compensated(form, plain),
        ErrorSample.compensated(form, usual),
    )
    return StudyResult(
        name=NAME,
        title="Volumetric error of machines measured and identified one by one",
        columns=COLUMNS,
        rows=_rows(found, plain, usual),
        summary=_summary(found, plain, usual) | {"balls_measured": planned.size},
        draw=partial(_draw, found=found),
        size_in=(10.0, 4.2),
    )


def with_stated_scales(options: Options) -> Options:
    """Return the identification options changed so that all uncertainties are used as stated and no outliers are
    rejected. The estimate is then linear in the measurements."""
    return replace(options, estimate_scales=False, outliers="none")


@dataclass(frozen=True, eq=False)
class SimulationComparison:
    """Comparison of volumetric errors computed in closed form and by simulation.

    `closed` is the volumetric error after compensation (VCE) in closed form, and `before` the simulated volumetric
    error without compensation. `plain` is the simulated VCE if machines are identified with all uncertainties as
    stated, as `closed` assumes. `usual` is the simulated VCE if machines are identified as in a run, which estimates
    scale factors for the uncertainties. `before` contains all machines, and `plain` and `usual` those that were
    identified.
    """

    closed: VolumetricRms
    before: ErrorSample
    plain: ErrorSample
    usual: ErrorSample


COLUMNS = (
    "machine",
    "ve_raw_um",
    "ve_aligned_um",
    "vce_raw_um",
    "vce_aligned_um",
    "vce_scales_as_stated_raw_um",
    "vce_scales_as_stated_aligned_um",
    "chi2_normalised",
    "balls_rejected",
    "refused",
)
"""Columns of the table. The last one contains the reason if the machine is refused as a run identifies it."""


def _rows(found: SimulationComparison, plain: Sequence[Outcome], usual: Sequence[Outcome]) -> list[list[Cell]]:
    before = zip(
        (UM_PER_MM * found.before.raw_mm).tolist(), (UM_PER_MM * found.before.aligned_mm).tolist(), strict=True
    )
    errors = zip(before, _errors_um(found.usual, usual), _errors_um(found.plain, plain), strict=True)
    return [
        [number, *(value for pair in pairs for value in pair), *_facts(machine)]
        for number, (pairs, machine) in enumerate(zip(errors, usual, strict=True))
    ]


def _errors_um(sample: ErrorSample, machines: Sequence[Outcome]) -> Iterator[tuple[float | None, float | None]]:
    """Yield the errors in µm, as defined and aligned, of each of `machines`; None if it was refused. `sample` contains
    those of the others."""
    errors = zip((UM_PER_MM * sample.raw_mm).tolist(), (UM_PER_MM * sample.aligned_mm).tolist(), strict=True)
    for machine in machines:
        yield (None, None) if isinstance(machine, RefusedMachine) else next(errors)


def _facts(machine: Outcome) -> tuple[Cell, Cell, Cell]:
    if isinstance(machine, RefusedMachine):
        return None, None, machine.reason
    return machine.chi2_normalised, machine.rejected, None


def _summary(found: SimulationComparison, plain: Sequence[Outcome], usual: Sequence[Outcome]) -> dict[str, object]:
    return {
        "machines_refused": {"as_a_run_identifies": found.usual.refused, "scales_as_stated": found.plain.refused},
        "refusals": {
            name: [{"machine": one.number, "reason": one.reason} for one in refused(machines)]
            for name, machines in (("as_a_run_identifies", usual), ("scales_as_stated", plain))
        },
        "ve": _figures(found.before),
        "vce": _figures(found.usual),
        "vce_scales_as_stated": _figures(found.plain),
        "vce_closed_form": {"raw_um": found.closed.raw_um, "aligned_um": found.closed.aligned_um},
        "deviation_in_standard_errors": {
            "raw": deviation(found.plain.expected.raw_mm, found.closed.raw_mm, found.plain.standard_error.raw_mm),
            "aligned": deviation(
                found.plain.expected.aligned_mm, found.closed.aligned_mm, found.plain.standard_error.aligned_mm
            ),
        },
        "chi2_normalised_mean": float(np.mean([machine.chi2_normalised for machine in identified(usual)])),
        "balls_rejected": sum(machine.rejected for machine in identified(usual)),
    }


def deviation(simulated_mm: float, closed_mm: float, error_mm: float) -> float | None:
    """Return the simulated value minus the value computed in closed form, in units of the simulated value's standard
    error. Return None if the standard error is zero, as for a single machine."""
    return (simulated_mm - closed_mm) / error_mm if error_mm > 0.0 else None


def _figures(spread: ErrorSample) -> dict[str, object]:
    """Return root mean square with its standard error, median and central 95 % interval in µm."""
    expected, error = spread.expected, spread.standard_error
    figures: dict[str, object] = {}
    for kind, values, mean_um, error_um in (
        ("raw", spread.raw_mm, expected.raw_um, error.raw_um),
        ("aligned", spread.aligned_mm, expected.aligned_um, error.aligned_um),
    ):
        low, median, high = (UM_PER_MM * np.percentile(values, (2.5, 50.0, 97.5))).tolist()
        figures[f"{kind}_um"] = mean_um
        figures[f"{kind}_standard_error_um"] = error_um
        figures[f"{kind}_median_um"] = median
        figures[f"{kind}_middle_95_um"] = [low, high]
    return figures


def _truths(machines: Sequence[Outcome]) -> Array:
    return np.array([machine.truth for machine in machines])


def _error_of_root(values_mm: Array) -> float:
    squares = values_mm**2
    if len(squares) < 2:
        return 0.0
    # standard error of the mean square m, carried through the root: d√m = dm / (2 √m)
    return float(squares.std(ddof=1) / np.sqrt(len(squares)) / (2.0 * np.sqrt(squares.mean())))


def _draw(figure: Figure, *, found: SimulationComparison) -> None:
    left, right = figure.subplots(1, 2)
    _draw_distribution(left, found)
    _draw_convergence(right, found)


def _draw_distribution(axes: Axes, found: SimulationComparison) -> None:
    for spread, colour, label in (
        (found.before, ORANGE, "VE, not compensated"),
        (found.usual, BLUE, "VCE, as a run identifies"),
        (found.plain, GREEN, "VCE, scales as stated"),
    ):
        values = np.sort(spread.aligned_mm) * UM_PER_MM
        share = 100.0 * (np.arange(len(values)) + 1.0) / len(values)
        without = f"; {spread.refused} refused left out" if spread.refused else ""
        axes.step(values, share, color=colour, label=label + without, where="post")
    axes.set_xlabel("volumetric error, rigidly aligned / µm")
    axes.set_xlim(left=0.0)
    from_zero(axes, "share of the machines below / %")
    axes.set_ylim(top=145.0)  # room for the legend above the curves
    axes.set_yticks(range(0, 101, 20))
    axes.legend(loc="upper left")
    axes.set_title("Distribution over the machines")


def _draw_convergence(axes: Axes, found: SimulationComparison) -> None:
    """Draw the running root mean square over the machines with its uncertainty, and the closed form as its limit."""
    squares = (UM_PER_MM * found.plain.aligned_mm) ** 2
    count = np.arange(1, len(squares) + 1)
    mean = np.cumsum(squares) / count
    variance = np.maximum(np.cumsum(squares**2) / count - mean**2, 0.0)
    error = COVERAGE_FACTOR * np.sqrt(variance / count) / (2.0 * np.sqrt(mean))
    axes.fill_between(count, np.sqrt(mean) - error, np.sqrt(mean) + error, color=GREEN, alpha=BAND_OPACITY, lw=0.0)
    axes.plot(count, np.sqrt(mean), color=GREEN, label="simulation, scales as stated, ± 2 standard errors")
    axes.axhline(found.closed.aligned_um, color=INK, linestyle="--", label="closed form")
    axes.set_xlabel("machines identified")
    from_zero(axes, "root mean square VCE, aligned / µm")
    axes.legend(loc="lower right")
    axes.set_title("Simulation and closed form")
