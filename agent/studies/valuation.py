"""Test of the valuation of position sets. The valuation of a set of artefact positions is the expected reduction of the
volumetric error by compensation in percent. It is computed before any measurement. For random sets, the study compares
the valuation with the simulated volumetric error after compensation (VCE).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import spearmanr

from agent.figures.style import BLUE, INK, ORANGE, from_zero
from agent.planning.design.set_valuation import valuation_of
from agent.studies.monte_carlo import ErrorSample, Outcome, ProcedureTask, check_refusals, mostly_refused, refused
from agent.studies.study import StudyCase, StudyResult
from agent.studies.workers import generator
from twin.arrays import Array
from twin.artefact.position_set import Position
from twin.design.candidates import orientation_grid
from twin.errors import DataError
from twin.machine.volumetric import evaluation_grid
from twin.uncertainty.residual_field_form import FieldForm

NAME = "valuation"
GRID_DEG = 15.0
RANDOM_SETS = 60
SMALLEST, LARGEST = 2, 24
NAMED = ("S1", "S2", "S3", "S1+S3", "S1+S2+S3")
MACHINES_SHARE, MIN_MACHINES = 20, 4
"""Each set is simulated on 1/20 of the machines of the case, but on at least 4 machines. The machines are the same for
every set."""
COLUMNS = (
    "set",
    "positions",
    "stations",
    "valuation_percent",
    "expected_vce_um",
    "simulated_vce_um",
    "standard_error_um",
    "machines",
    "machines_refused",
)


@dataclass(frozen=True, eq=False)
class SetTask:
    """Task that simulates one of the measuring procedures `procedures` on `machines` machines. The task is called with
    the index of the procedure.
    """

    procedures: Sequence[ProcedureTask]
    machines: int

    def __call__(self, number: int) -> list[Outcome]:
        return [self.procedures[number](machine) for machine in range(self.machines)]


@dataclass(frozen=True)
class SimulatedSet:
    """Results of one position set. `valuation` is the expected reduction of the volumetric error by compensation in %.
    `expected_um` is the expected volumetric error after compensation (VCE), `simulated_um` is the rms VCE of the
    simulated machines, and `error_um` is the standard error of this rms value. All errors are computed after the
    best-fitting rigid motion is removed.

    `machines` is the number of simulated machines, and `refused` the number of those that the identification refuses;
    the simulated values are those of the others. If more than half are refused, `simulated_um` and `error_um` are None.
    """

    name: str
    positions: int
    stations: int
    valuation: float
    expected_um: float
    simulated_um: float | None
    error_um: float | None
    machines: int
    refused: int


def run(case: StudyCase) -> StudyResult:
    """Compare the valuation of position sets (expected reduction of the volumetric error) with the simulated volumetric
    error after compensation. The sets are `RANDOM_SETS` (60) random sets and the named sets in `NAMED`.
    """
    machines = max(MIN_MACHINES, case.machines // MACHINES_SHARE)
    sets = [(name, tuple(case.positions(name))) for name in NAMED]
    sets += [(f"random {number + 1}", chosen) for number, chosen in enumerate(random_sets(case, RANDOM_SETS))]
    planned = [case.procedure.plan(positions) for _, positions in sets]
    task = SetTask([ProcedureTask.of(case, one.observations) for one in planned], machines)
    simulated = case.map(task, range(len(sets)), f"sets, {machines} machines each")
    _check_sets(case, simulated)
    grid = evaluation_grid(case.machine.model.ranges_mm)
    form = FieldForm.build(case.machine.model, case.assumptions, grid, case.tool_offset)
    tried = [
        _evaluate_set(case, name, one.positions, form, found)
        for (name, _), one, found in zip(sets, planned, simulated, strict=True)
    ]
    used = [one for one in tried if one.simulated_um is not None]
    before = ErrorSample.uncompensated(form, simulated[0]).expected.aligned_um
    return StudyResult(
        name=NAME,
        title="The valuation of a set against the error that is really left",
        columns=COLUMNS,
        rows=[tuple(vars(one).values()) for one in tried],
        summary=_summary(tried, used, before, machines),
        draw=partial(_draw, tried=used, before_um=before),
    )


def random_sets(case: StudyCase, count: int) -> list[tuple[Position, ...]]:
    """Return `count` random sets of 2 to 24 reachable positions of the artefact. The stations of each set are a random
    choice of one or more stations.
    """
    reached = _within_reach(case)
    found = []
    for number in range(count):
        rng = generator(case.seed, number)
        stations = sorted({position.station for position in reached})
        chosen = rng.choice(stations, size=int(rng.integers(1, len(stations) + 1)), replace=False)
        offered = [position for position in reached if position.station in chosen]
        size = min(round(np.exp(rng.uniform(np.log(SMALLEST), np.log(LARGEST + 1)))), LARGEST, len(offered))
        found.append(tuple(offered[index] for index in sorted(rng.choice(len(offered), size=size, replace=False))))
    return found


def _within_reach(case: StudyCase) -> list[Position]:
    offered = [Position(s, *angles) for s in case.procedure.stations for angles in orientation_grid(GRID_DEG)]
    reached = list(case.procedure.plan(offered).positions)
    if len(reached) < LARGEST:
        raise DataError(f"only {len(reached)} positions are within reach", hint="use another machine or artefact")
    return reached


def _check_sets(case: StudyCase, simulated: Sequence[Sequence[Outcome]]) -> None:
    """Raise RunError if the identification refuses more than half of the machines in more than half of the sets."""
    useless = [machines for machines in simulated if mostly_refused(machines)]
    if 2 * len(useless) > len(simulated):
        check_refusals(case, [machine for machines in useless for machine in machines])


def _evaluate_set(
    case: StudyCase, name: str, positions: Sequence[Position], form: FieldForm, machines: Sequence[Outcome]
) -> SimulatedSet:
    left = None if mostly_refused(machines) else ErrorSample.compensated(form, machines)
    worth = valuation_of(case.job, positions)
    return SimulatedSet(
        name=name,
        positions=len(positions),
        stations=len({position.station for position in positions}),
        valuation=worth.percent,
        expected_um=worth.after.aligned_um,
        simulated_um=None if left is None else left.expected.aligned_um,
        error_um=None if left is None else left.standard_error.aligned_um,
        machines=len(machines),
        refused=len(refused(machines)),
    )


def _summary(
    tried: Sequence[SimulatedSet], used: Sequence[SimulatedSet], before_um: float, machines: int
) -> dict[str, object]:
    """Return the summary. `used` are those of the sets `tried` that have simulated values."""
    valuations, simulated = [one.valuation for one in used], _simulated_um(used)
    return {
        "set": f"{RANDOM_SETS} random sets and {', '.join(NAMED)}",
        "machines": machines,
        "sets": len(tried),
        "sets_refused": len(tried) - len(used),
        "machines_refused": sum(one.refused for one in tried),
        "simulated_ve_um": before_um,
        "rank_correlation": float(-spearmanr(valuations, simulated).statistic),
        "correlation": float(-np.corrcoef(valuations, simulated)[0, 1]),
        "simulated_over_expected": float(np.median(simulated / np.array([one.expected_um for one in used]))),
    }


def _simulated_um(used: Sequence[SimulatedSet]) -> Array:
    return np.array([one.simulated_um for one in used], dtype=np.float64)


def _draw(figure: Figure, tried: Sequence[SimulatedSet], before_um: float) -> None:
    axes = figure.subplots()
    named = [one for one in tried if one.name in NAMED]
    for group, colour, marker, label in (
        ([one for one in tried if one not in named], BLUE, "o", "random sets of 2 to 24 positions"),
        (named, ORANGE, "D", "named sets"),
    ):
        axes.errorbar(
            [one.valuation for one in group],
            _simulated_um(group),
            np.array([one.error_um for one in group], dtype=np.float64),
            fmt=marker,
            color=colour,
            elinewidth=0.8,
            label=label,
        )
    for one, simulated_um in zip(named, _simulated_um(named), strict=True):
        both = one.name.count("+") == 1  # as good as all sets together: its name goes to the other side
        offset, side = ((-6, -14), "right") if both else ((6, -14 if "+" in one.name else 4), "left")
        axes.annotate(one.name, (one.valuation, simulated_um), offset, textcoords="offset points", ha=side)
    axes.plot(
        [0.0, 100.0],
        [before_um, 0.0],
        ":",
        color=INK,
        linewidth=0.9,
        label="VE of these machines, reduced by the valuation",
    )
    rank = float(-spearmanr([one.valuation for one in tried], _simulated_um(tried)).statistic)
    axes.set_xlabel("valuation before anything moves / %")
    axes.set_xlim(0.0, 100.0)
    axes.set_title(f"Valuation and simulated VCE of {len(tried)} sets (rank correlation {rank:.3f})")
    from_zero(axes, "simulated VCE, rigidly aligned, rms over machines / µm")
    axes.legend()
