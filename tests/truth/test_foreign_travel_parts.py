"""Volumetric error inside and outside the measured region, compared with the truth of foreign machines."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from agent.results.estimation import travel_parts, volumetric_summary
from agent.results.facts import VolumetricSummary
from agent.results.travel_parts import TravelPart, TravelParts
from campaigns.foreign.artefact import S3, measure, tilted_bar
from campaigns.foreign.machine import TOOL, foreign_machine
from campaigns.foreign.score import family_of
from twin.compensation.table import MeasuredRegion
from twin.identification import Options, identify_by_evidence
from twin.machine.forward_model import exact_deviation
from twin.machine.volumetric import align_rigidly, evaluation_grid

SEEDS = range(12)


@cache
def parts_and_truth(seed: int) -> tuple[TravelParts, VolumetricSummary, tuple[float, float]]:
    """Return the stated parts, the stated errors of the whole travel, and the true errors inside and outside the
    measured region after compensation, all in µm."""
    rng = np.random.default_rng(seed)
    machine, bar = foreign_machine(rng), tilted_bar(rng)
    seen = measure(machine, bar, S3, np.random.default_rng(seed + 100)).seen
    estimate = identify_by_evidence(family_of, seen, bar.artefact, Options())
    grid = evaluation_grid(estimate.model.ranges_mm)
    inside = MeasuredRegion.around(seen.axis_positions).contains(grid)
    left = machine.deviation(grid) - exact_deviation(estimate.model, grid, TOOL, estimate.parameters)
    squares = 1e6 * np.square(align_rigidly(grid + TOOL, left)).sum(axis=1)
    true_um = float(np.sqrt(squares[inside].mean())), float(np.sqrt(squares[~inside].mean()))
    stated = travel_parts(estimate, TOOL, seen.axis_positions)
    return stated, volumetric_summary(estimate, TOOL), true_um


def both(parts: TravelParts) -> tuple[TravelPart, TravelPart]:
    assert parts.measured is not None
    assert parts.unmeasured is not None
    return parts.measured, parts.unmeasured


@pytest.mark.parametrize("which", [0, 1], ids=["measured", "unmeasured"])
def test_the_prediction_is_honest_in_both_parts(which: int) -> None:
    ratios, inside = [], 0
    for seed in SEEDS:
        stated, _, true_um = parts_and_truth(seed)
        part = both(stated)[which]
        ratios.append(true_um[which] / part.predicted_vce_um)
        lower, upper = part.predicted_vce_limits_um
        inside += lower <= true_um[which] <= upper
    assert 0.7 < np.mean(ratios) < 1.3
    assert max(ratios) < 2.0
    assert inside >= 8


def test_less_is_known_where_no_ball_was() -> None:
    for seed in SEEDS:
        measured, unmeasured = both(parts_and_truth(seed)[0])
        assert unmeasured.predicted_vce_um > 1.2 * measured.predicted_vce_um


def test_the_parts_add_up_to_the_whole() -> None:
    stated, whole, _ = parts_and_truth(0)
    for name, whole_um in (
        ("estimated_ve_um", whole.before_aligned.value_um),
        ("table_ve_um", whole.table_ve_um),
        ("predicted_vce_um", whole.after_aligned.value_um),
    ):
        squares = sum(part.share * getattr(part, name) ** 2 for part in both(stated))
        assert np.sqrt(squares) == pytest.approx(whole_um, rel=1e-6), name
    assert sum(part.share for part in both(stated)) == pytest.approx(1.0)
