"""Straight bars: balls within some micrometres of a line, clamped at any roll."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from campaigns.foreign.artefact import S1, S2, S3, ForeignBar, measure, straight_bar, tilted_bar, turned_bar
from campaigns.foreign.machine import foreign_machine
from campaigns.foreign.score import Score, family_of, score
from twin.identification import Options
from twin.identification.roll import build_measured_problem

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


@pytest.mark.parametrize("across_mm", [0.0, 0.020])
@pytest.mark.parametrize("seed", [0, 3])
def test_the_roll_is_found_with_an_uncertified_ball_far_off_the_line_too(seed: int, across_mm: float) -> None:
    """The other balls are 5 µm off the line: errors of the machine of 1 µm turn the bar by some hundredths of a rad."""
    rng = np.random.default_rng(seed)
    machine, bar = foreign_machine(rng), replace(straight_bar(rng, 0.005), uncertified=(4,))
    real = replace(bar, true=bar.true + across_mm * np.outer(np.arange(11) == 4, [0.0, 1.0, 0.0]))
    measured = measure(machine, real, S1 + S2 + S3, np.random.default_rng(seed + 100))
    seen = measured.seen
    problem = build_measured_problem(family_of(6), seen, bar.artefact, Options())
    errors = []
    for number, roll in enumerate(measured.roll_rad):
        row = int(np.argmax(seen.position == number))
        assert seen.azimuth_rad is not None
        true = turned_bar(seen.azimuth_rad[row], seen.elevation_rad[row], roll)
        change = true.T @ problem.poses.rotation[number]
        errors.append(np.arctan2(change[2, 1] - change[1, 2], change[1, 1] + change[2, 2]))
    assert np.abs(errors).max() < 0.3
