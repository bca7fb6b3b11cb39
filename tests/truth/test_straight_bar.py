"""Straight bars: balls within some micrometres of a line, clamped at any roll."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from foreign_artefact import S1, S2, S3, ForeignBar, measure, straight_bar, tilted_bar
from foreign_machine import foreign_machine
from foreign_score import Score, score

SEEDS = range(3)


def straight_score(seed: int, off_axis_mm: float, across_mm: float = 0.0) -> Score:
    rng = np.random.default_rng(seed)
    machine, bar = foreign_machine(rng), straight_bar(rng, off_axis_mm)
    real = replace(bar, true=bar.true + across_mm * np.outer(np.arange(11) == 4, [0.0, np.cos(seed), np.sin(seed)]))
    seen = measure(machine, real, S1 + S2 + S3, np.random.default_rng(seed + 100)).seen
    return score(machine, bar, seen)


@pytest.mark.parametrize("off_axis_mm", [0.002, 0.005, 0.015])
@pytest.mark.parametrize("seed", SEEDS)
def test_a_straight_bar_at_any_roll_identifies_as_well_as_stated(seed: int, off_axis_mm: float) -> None:
    found = straight_score(seed, off_axis_mm)
    assert found.estimate.rejected == ()
    assert found.after_um < 0.4 * found.before_um
    assert 0.5 < found.ratio < 1.3
    assert 0.8 < found.estimate.chi2_normalised < 1.3


@pytest.mark.parametrize("seed", SEEDS)
def test_a_ball_far_off_the_line_does_not_break_it(seed: int) -> None:
    with_it, without = straight_score(seed, 0.005, across_mm=0.020), straight_score(seed, 0.005)
    assert len(with_it.estimate.rejected) <= 2
    assert with_it.after_um < 1.15 * without.after_um


@pytest.mark.parametrize("seed", SEEDS)
def test_a_bar_certified_as_perfectly_straight_is_measured_too(seed: int) -> None:
    found = straight_score(seed, 0.0)
    assert found.estimate.rejected == ()
    assert found.after_um < 0.45 * found.before_um


def test_a_straight_bar_loses_nothing_against_a_tilted_one() -> None:
    def mean_after(bar_of: type[ForeignBar] | object) -> float:
        after = []
        for seed in SEEDS:
            rng = np.random.default_rng(seed)
            machine = foreign_machine(rng)
            bar = tilted_bar(rng) if bar_of is tilted_bar else straight_bar(rng, 0.005)
            seen = measure(machine, bar, S1 + S2 + S3, np.random.default_rng(seed + 100)).seen
            after.append(score(machine, bar, seen).after_um)
        return float(np.mean(after))

    assert mean_after(straight_bar) < 1.1 * mean_after(tilted_bar)
