"""One estimate from several tool offsets: its rank, and the benefit of the table of each tool."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from measured_set import RANGES, TOOL, bar, case_study, measured

from twin.compensation.table import build_table, regular_nodes
from twin.identification import Estimate, Options, identify
from twin.identification.observability import field_observability
from twin.machine.anchor import Anchor
from twin.machine.forward_model import exact_deviation
from twin.machine.volumetric import evaluation_grid, volumetric_error

LONGER, LATERAL = np.array([0.0, 450.0, 0.0]), np.array([0.0, 250.0, -400.0])
TOOLS = {"straight": TOOL, "longer": LONGER, "lateral": LATERAL}
MODEL, FAMILY = case_study(4)
RICHER, RICHER_FAMILY = case_study(6)
NODES = regular_nodes(RANGES, (200.0, 200.0, 200.0))
GRID = evaluation_grid(RANGES, (15, 8, 9))
SEEDS = range(4)


def truth(seed: int) -> np.ndarray:
    return RICHER_FAMILY.draw(np.random.default_rng(seed), 1)[0]


@cache
def estimate(seed: int, *names: str) -> Estimate:
    """Identify with every position replanned for every tool, as for a manual tool change."""
    tools = tuple(TOOLS[name] for name in names)
    errors = truth(seed)
    seen = measured(
        "S3",
        4,
        bar(),
        lambda X, t: exact_deviation(RICHER, X, t, errors),
        np.random.default_rng(seed),
        sigma_mm=3e-4,
        tools=tools,
    )
    seen = replace(seen, position=seen.position * len(tools) + seen.tool)
    return identify(MODEL, seen, bar(), FAMILY, Options(estimate_scales=False, outliers="none"))


def true_errors(seed: int, one: Estimate, tool: np.ndarray) -> tuple[float, float]:
    """Return the aligned VE in µm of the true machine with a tool, without and with the table for that tool."""
    table = build_table(MODEL, one.parameters, NODES, tool, Anchor(np.zeros(3)), GRID)
    assert table.tool_offset.tolist() == tool.tolist()
    command = GRID + table.at(GRID)
    bare = exact_deviation(RICHER, GRID, tool, truth(seed))
    left = command - GRID + exact_deviation(RICHER, command, tool, truth(seed))
    return volumetric_error(GRID + tool, bare).aligned_um, volumetric_error(GRID + tool, left).aligned_um


def sigma_share(one: Estimate, error: str) -> np.ndarray:
    block = MODEL.block[error]
    return one.standard_uncertainty[block] / one.prior_scale[block]


def test_rank_rises_with_each_tool_to_all_that_the_field_shows() -> None:
    """The model has 72 parameters: b0 and c0, which would make it 74, are off; of these, two lengths would reveal only
    c0."""
    for names, rank in ((("straight",), 56), (("straight", "longer"), 64), (tuple(TOOLS), 72)):
        one = estimate(0, *names)
        offsets = np.array([TOOLS[name] for name in names])
        assert one.rank == rank == field_observability(MODEL, one.prior_scale, offsets, aligned=True).rank
        assert one.tool_offsets.tolist() == offsets.tolist()
    assert MODEL.size == 72


@pytest.mark.parametrize("error", ["EBY", "EBZ"])
def test_only_a_lateral_stylus_shows_turns_about_the_tool(error: str) -> None:
    block = MODEL.block[error]
    for names in (("straight",), ("straight", "longer")):
        np.testing.assert_allclose(sigma_share(estimate(0, *names), error), 1.0, atol=1e-6)
        assert np.abs(estimate(0, *names).parameters[block]).max() < 1e-12
    assert sigma_share(estimate(0, *TOOLS), error)[0] < 0.5
    slope = RICHER.index(f"{error}[1]")
    real = np.array([truth(seed)[slope] for seed in SEEDS])
    known = np.array([estimate(seed, *TOOLS).parameters[block][0] for seed in SEEDS])
    assert np.linalg.norm(known - real) < 0.4 * np.linalg.norm(real)


@pytest.mark.parametrize("error", ["EAY", "ECY"])
def test_what_one_length_cannot_tell_apart_two_can(error: str) -> None:
    assert sigma_share(estimate(0, "straight"), error).min() > 0.95
    assert sigma_share(estimate(0, "straight", "longer"), error)[0] < 0.5


@pytest.mark.parametrize("name", TOOLS)
def test_the_table_of_each_tool_betters_the_true_machine_with_that_tool(name: str) -> None:
    alone, together = [], []
    for seed in SEEDS:
        bare, left_alone = true_errors(seed, estimate(seed, "straight"), TOOLS[name])
        _, left_together = true_errors(seed, estimate(seed, *TOOLS), TOOLS[name])
        assert left_together < 0.3 * bare
        alone.append(left_alone)
        together.append(left_together)
    assert np.mean(together) < 0.8 * np.mean(alone)
