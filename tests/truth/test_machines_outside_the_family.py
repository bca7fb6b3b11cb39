"""Machines that are far better or far worse than the family that the program takes as their prior population."""

from __future__ import annotations

from functools import cache, partial

import numpy as np
import pytest

from agent.probing.measured_balls import no_correction
from agent.results.table_replacement import expected_gain
from agent.settings.schema import VerificationSettings
from campaigns.foreign.artefact import S3, measure, tilted_bar
from campaigns.foreign.machine import TOOL, foreign_machine
from campaigns.foreign.score import Score, score
from twin.arrays import Array
from twin.machine.forward_model import deviation_basis

SEEDS = range(4)
MIN_GAIN = VerificationSettings().min_gain


@cache
def scores(worse: float, run: int = 0) -> list[Score]:
    """Identify machines `worse` times as bad as the family; each `run` measures the same machines anew."""
    found = []
    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        machine, bar = foreign_machine(rng, worse), tilted_bar(rng)
        found.append(score(machine, bar, measure(machine, bar, S3, np.random.default_rng(seed + 100 * (run + 1))).seen))
    return found


@pytest.mark.parametrize("worse", [3.0, 10.0, 30.0])
def test_a_machine_many_times_worse_is_predicted_as_it_is(worse: float) -> None:
    found = scores(worse)
    assert all(one.after_um < 0.4 * one.before_um for one in found)
    assert 0.6 < float(np.mean([one.ratio for one in found])) < 1.25
    assert max(one.ratio for one in found) < 1.5


@pytest.mark.parametrize("worse", [0.05, 0.1])
def test_a_nearly_perfect_machine_is_not_promised_what_it_does_not_get(worse: float) -> None:
    found = scores(worse)
    assert max(one.ratio for one in found) < 1.3
    assert float(np.mean([one.ratio for one in found])) > 0.6
    for one in found:
        promised = one.predicted_um < 0.8 * one.before_um
        assert one.after_um < one.before_um or not promised


def gain(found: Score, active: Score | None) -> float:
    """Return the gain that a run expects of its new table if the table of the run `active` is active."""

    def correction(of: Score | None, displayed: Array) -> Array:
        if of is None:
            return no_correction(displayed)
        return np.asarray(-deviation_basis(of.estimate.model, displayed, TOOL) @ of.estimate.parameters)

    former, new = partial(correction, active), partial(correction, found)
    return expected_gain(found.estimate, found.predicted_um, former, new, TOOL).fraction


@pytest.mark.parametrize("worse", [0.05, 0.1])
def test_a_nearly_perfect_machine_is_left_alone(worse: float) -> None:
    assert max(gain(found, None) for found in scores(worse)) < MIN_GAIN


def test_a_table_that_is_still_good_is_kept_and_a_table_of_another_machine_is_not() -> None:
    """The two runs know nothing of each other, so each believes in its own table by 7 to 22 %."""
    first, second = scores(1.0), scores(1.0, run=1)
    assert max(gain(new, old) for new, old in zip(second, first, strict=True)) < MIN_GAIN
    assert min(gain(new, None) for new in second) > 2.0 * MIN_GAIN
    assert min(gain(new, old) for new, old in zip(second, first[1:], strict=False)) > 2.0 * MIN_GAIN
