"""Cells of a table for the verdicts on measuring procedures. A verdict gives the volumetric error after compensation in
closed form and from simulation.
"""

from __future__ import annotations

from collections.abc import Sequence

from agent.studies.measure import MEASURES
from agent.studies.procedure_value import ProcedureVariant, Verdict
from agent.studies.study import Cell
from twin.machine.volumetric import VolumetricRms

COLUMNS = (
    "identification",
    "ball_centres",
    "vce_raw_um",
    "vce_work_frame_um",
    "vce_aligned_um",
    "simulated_vce_raw_um",
    "simulated_vce_raw_standard_error_um",
    "simulated_vce_aligned_um",
    "simulated_vce_aligned_standard_error_um",
    "machines_refused",
)
"""Columns of a verdict. `vce_…` are in closed form; a cell is empty if the machine is not identified or not
simulated. `machines_refused` counts simulated machines that the identification refuses because their measurements
contradict; the simulated values are those of the others."""


MIN_MACHINES = 30
"""Number of machines below which the standard error is too uncertain to be used."""


def cells(label: str, trial: ProcedureVariant, verdict: Verdict) -> tuple[Cell, ...]:
    """Return the cells of one table row for `verdict` (the volumetric error after compensation with the procedure
    `trial`), in the order of the column names `COLUMNS`. `label` is the name of the identification variant.
    """
    measured = 0 if trial.planned is None else trial.planned.size
    expected = [measure.um(verdict) for measure in MEASURES]
    simulated, error = _both(verdict.simulated), _both(verdict.standard_error)
    return (label, measured, *expected, simulated[0], error[0], simulated[1], error[1], verdict.refused)


def refused_machines(rows: Sequence[Sequence[Verdict]]) -> int:
    """Return the number of simulated machines that the identification refuses, over all verdicts in `rows`."""
    return sum(verdict.refused for row in rows for verdict in row)


def worst_deviation(rows: Sequence[Sequence[Verdict]]) -> float | None:
    """Return the largest absolute difference between the simulated and the closed-form volumetric error after
    compensation (VCE) over all verdicts in `rows`. Each difference is divided by the standard error of the simulated
    VCE.

    The VCE is computed after the best-fitting rigid motion is removed. Return None if no verdict has at least
    `MIN_MACHINES` simulated machines.
    """
    distances = [
        abs(verdict.simulated.aligned_mm - verdict.expected.aligned_mm) / verdict.standard_error.aligned_mm
        for verdict in (verdict for row in rows for verdict in row)
        if verdict.expected is not None and verdict.simulated is not None and verdict.standard_error is not None
        if verdict.machines >= MIN_MACHINES
    ]
    return max(distances, default=None)


def _both(value: VolumetricRms | None) -> tuple[float | None, float | None]:
    return (None, None) if value is None else (value.raw_um, value.aligned_um)
