"""A true machine, and the simpler estimate of it with its table."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from agent.model_files import load_machine
from twin.compensation.controllers.export_format import ExportSource, TableEstimate
from twin.compensation.table import build_table, regular_nodes
from twin.machine.anchor import Anchor
from twin.machine.error_model import ErrorModel
from twin.machine.forward_model import deviation_basis, exact_deviation
from twin.machine.kinematic_chain import parse_chain
from twin.machine.machine_population import family_from_amplitudes
from twin.machine.true_machine import TrueMachine, draw_machine
from twin.machine.volumetric import evaluation_grid, volumetric_error

CASE_STUDY = load_machine(Path(__file__).parents[4] / "config" / "machines" / "case-study.toml")
RANGES = CASE_STUDY.model.ranges_mm
TOOL = CASE_STUDY.tool("probe")
GRID = evaluation_grid(RANGES, (9, 6, 6))


@cache
def truth(seed: int) -> TrueMachine:
    """Return the true machine: Legendre order 7 and a deflection that no series represents."""
    rng = np.random.default_rng(seed)
    return draw_machine(CASE_STUDY, "probe", order=7, scale=1.0, with_deflection=True, rng=rng)


@cache
def known(seed: int) -> ExportSource:
    """Return the best fit of order 5, perturbed by a little noise, and its table."""
    points = evaluation_grid(RANGES, (9, 7, 7))
    model = CASE_STUDY.model
    scale = CASE_STUDY.family.prior_standard_deviation
    basis = deviation_basis(model, points, TOOL, scale).reshape(-1, model.size)
    motions = np.linalg.lstsq(basis, truth(seed).deviation(points).reshape(-1), rcond=1e-6)[0]
    noise = 0.02 * np.random.default_rng(seed + 1000).standard_normal(model.size)
    return source_of(model, scale * (motions + noise), np.diag((0.02 * scale) ** 2))


def source_of(
    model: ErrorModel,
    parameters: np.ndarray,
    covariance: np.ndarray | None = None,
    step_mm: tuple[float, float, float] = (100.0, 100.0, 100.0),
    tool: np.ndarray = TOOL,
) -> ExportSource:
    nodes = regular_nodes(model.ranges_mm, step_mm)
    anchor = Anchor(np.array([low for low, _ in model.ranges_mm]))
    everywhere = evaluation_grid(model.ranges_mm, (3, 3, 3))
    table = build_table(model, parameters, nodes, tool, anchor, everywhere)
    matrix = np.zeros((model.size, model.size)) if covariance is None else covariance
    return ExportSource(table, TableEstimate(model, parameters, matrix))


def machine_with(**parameters: float) -> ExportSource:
    """Return the case study with only these parameters, such as EXX_1=4e-3 for EXX[1] or CROSS_b1."""
    values = np.zeros(CASE_STUDY.model.size)
    for name, value in parameters.items():
        head, _, tail = name.partition("_")
        values[CASE_STUDY.model.index(f"{head}[{tail}]" if tail else head)] = value
    return source_of(CASE_STUDY.model, values)


def moving_table(seed: int) -> ExportSource:
    """Return a machine whose table carries the workpiece in X and Y."""
    model = ErrorModel.uniform(parse_chain("tool-Z-bed-Y-X-workpiece"), RANGES, 4)
    return source_of(
        model, family_from_amplitudes(model, CASE_STUDY.amplitudes).draw(np.random.default_rng(seed), 1)[0]
    )


def left_um(machine: TrueMachine, added: np.ndarray) -> float:
    """Return the true aligned VE with `added` (n, 3) added to the commands GRID."""
    return volumetric_error(GRID + TOOL, added + machine.deviation(GRID + added)).aligned_um


def left_of_estimate_um(source: ExportSource, added: np.ndarray, grid: np.ndarray = GRID) -> float:
    known_of = source.estimate
    assert known_of is not None, "only a source with its estimate has a remaining error"
    offset = source.table.tool_offset
    left = added + exact_deviation(known_of.model, grid + added, offset, known_of.parameters)
    return volumetric_error(grid + offset, left).aligned_um
