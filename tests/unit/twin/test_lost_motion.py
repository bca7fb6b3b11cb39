"""Lost motion from oblique touches: geometry by hand, the fit compared with plain differences, and refusals."""

from __future__ import annotations

import math

import numpy as np
import pytest

from twin.artefact.reversal import fit_lost_motion, plan_oblique_touches
from twin.errors import DataError

ALONG_Y = np.array([0.0, 1.0, 0.0])


@pytest.mark.parametrize(("axis", "along"), [(0, 1), (1, 0), (2, 1)])
def test_places_are_oblique_before_the_ball_and_touched_by_another_axis_alone(axis: int, along: int) -> None:
    first, second = plan_oblique_touches(axis, ALONG_Y)
    for touch in (first, second):
        assert touch.along == along
        assert abs(touch.normal[axis]) == pytest.approx(math.sqrt(0.5))
        assert touch.normal[1] < 0.0
        assert float(touch.normal @ touch.direction) < 0.0
        assert np.count_nonzero(touch.direction) == 1
        assert abs(touch.ratio) == pytest.approx(1.0)
    assert float(first.normal @ second.normal) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_sign_is_that_of_a_slide_that_lags(axis: int) -> None:
    """Touch a sphere of 15 mm with a tip whose preloaded axis lags by ±4 µm; the reading follows from Pythagoras."""
    latched, upwards, ratios, places = [], [], [], []
    for place, touch in enumerate(plan_oblique_touches(axis, ALONG_Y)):
        for up in (True, False):
            lag = -0.004 if up else 0.004
            off = 15.0 * touch.normal[axis] + lag
            reached = math.copysign(math.sqrt(15.0**2 - off**2), touch.normal[touch.along])
            latched.append(reached)
            upwards.append(up)
            ratios.append(touch.ratio)
            places.append(place)
    assert fit_lost_motion(ratios, upwards, places, latched, 1e-6).value_mm == pytest.approx(0.008, rel=1e-3)


def test_fit_is_the_difference_of_the_means_and_its_uncertainty_that_of_hand_arithmetic() -> None:
    """Use one point, ratio 1, levels 1 ± b/2 with residuals ±d: b = difference of the means, σ = s·√(2/2)."""
    latched = [1.000 + 0.003 + 0.001, 1.0 - 0.003 - 0.001, 1.0 - 0.003 + 0.001, 1.0 + 0.003 - 0.001]
    found = fit_lost_motion([1.0] * 4, [True, False, False, True], [0] * 4, latched, 0.0)
    assert found.value_mm == pytest.approx(0.006)
    assert found.sigma_mm == pytest.approx(math.sqrt(4 * 0.001**2 / 2))
    floored = fit_lost_motion([1.0] * 4, [True, False, False, True], [0] * 4, latched, 0.01)
    assert floored.sigma_mm == pytest.approx(0.01)


def test_a_steady_drift_drops_out_of_up_down_down_up() -> None:
    drift = [0.000, 0.002, 0.004, 0.006]
    found = fit_lost_motion([1.0] * 4, [True, False, False, True], [0] * 4, drift, 1e-6)
    assert found.value_mm == pytest.approx(0.0, abs=1e-12)


def test_touches_from_one_side_only_and_a_slanting_stylus_are_refused() -> None:
    with pytest.raises(DataError, match="one side only"):
        fit_lost_motion([1.0, 1.0], [True, True], [0, 0], [0.0, 0.1], 1e-3)
    with pytest.raises(DataError, match="machine axis"):
        plan_oblique_touches(0, np.array([0.6, 0.8, 0.0]))
