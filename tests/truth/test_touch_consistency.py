"""Wrong touches in positions whose balls are touched three times, on machines of the independent generator."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from campaigns.touch_check import count, five_touch_power, positions_of
from twin.artefact.position_set import CHECKABLE_BALLS

SEEDS = range(100, 104)


def test_wrong_touches_are_found_that_five_touches_of_a_ball_do_not_show() -> None:
    counts = count(SEEDS, worse=1.0)
    assert counts.alarms <= 1
    assert counts.found[15.0] >= 0.95 * counts.positions > five_touch_power(15.0) * counts.positions
    assert counts.found[30.0] == counts.positions
    assert counts.others <= 0.02 * len(counts.found) * counts.positions


def test_a_machine_ten_times_worse_than_its_family_raises_few_false_alarms() -> None:
    counts = count(SEEDS, worse=10.0)
    assert counts.alarms <= 0.03 * counts.positions
    assert counts.found[50.0] >= 0.9 * counts.positions


def test_two_wrong_balls_are_both_found() -> None:
    found = 0
    for seen, check in positions_of(200, 1.0):
        moved = seen.axis_positions.copy()
        moved[2] += 0.02 * check.directions[0]
        moved[7] -= 0.025 * check.directions[1]
        named = check.inconsistent(replace(seen, axis_positions=moved))
        found += {one.ball for one in named} == {2, 7}
        for one in named:
            touch, off_mm = {2: (0, 0.02), 7: (1, -0.025)}.get(one.ball, (one.touch, one.deviation_mm))
            assert one.touch == touch
            assert one.deviation_mm == pytest.approx(off_mm, abs=0.006)
    assert found >= 22


def test_few_balls_cannot_be_checked() -> None:
    seen, check = next(positions_of(201, 1.0))
    few = seen.select(np.arange(CHECKABLE_BALLS - 1))
    moved = few.axis_positions.copy()
    moved[0] += 1.0 * check.directions[0]
    assert check.inconsistent(replace(few, axis_positions=moved)) == ()


def test_the_deviation_of_a_touch_is_that_from_the_prediction_by_all_others() -> None:
    """Golden case: conditional normal distribution with the touch left out, by plain matrix inversion."""
    seen, check = next(positions_of(202, 1.0))
    residuals, machine, beside = check._touches(seen)
    covariance = machine + beside
    deviations, standardised = check.deviations(seen)
    for touch in (0, 7, 32):
        others = np.delete(np.arange(len(residuals)), touch)
        gain = covariance[touch, others] @ np.linalg.inv(covariance[np.ix_(others, others)])
        off = residuals[touch] - gain @ residuals[others]
        variance = covariance[touch, touch] - gain @ covariance[others, touch]
        assert deviations.ravel()[touch] == pytest.approx(off, rel=1e-4, abs=1e-8)
        assert standardised.ravel()[touch] == pytest.approx(off / np.sqrt(variance), rel=1e-4, abs=1e-5)
