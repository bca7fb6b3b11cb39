"""Machines that are far better or far worse than the family that the program takes as their prior population."""

from __future__ import annotations

import numpy as np
import pytest

from campaigns.foreign.artefact import S3, measure, tilted_bar
from campaigns.foreign.machine import foreign_machine
from campaigns.foreign.score import Score, score

SEEDS = range(4)


def scores(worse: float) -> list[Score]:
    found = []
    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        machine, bar = foreign_machine(rng, worse), tilted_bar(rng)
        found.append(score(machine, bar, measure(machine, bar, S3, np.random.default_rng(seed + 100)).seen))
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
    for one in found:
        promised = one.predicted_um < 0.8 * one.before_um
        assert one.after_um < one.before_um or not promised
