"""Probability that a drifting value reaches its limit, compared with closed forms and symmetries."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import invgauss, norm

from twin.errors import DataError
from twin.monitoring.limit_forecast import MIN_VALUES, SPANS_AHEAD, LimitForecast, forecast_limit, passage_probability

NIGHTS = np.arange(40.0)
VALUES = 2.0 + 0.1 * NIGHTS + 0.3 * np.random.default_rng(5).standard_normal(40)


def forecast(values: np.ndarray, limit: float = 8.0, **options: object) -> LimitForecast:
    chosen = {"nights": NIGHTS, "sigmas": np.ones(len(values)), "two_sided": False, **options}
    found = forecast_limit(values=values, limit=limit, **chosen)  # type: ignore[arg-type]
    assert found is not None
    return found


def test_a_walk_with_drift_reaches_a_limit_as_an_inverse_gaussian_time() -> None:
    room, slope, rate, ahead = 3.0, 0.2, 0.4, np.array([1.0, 5.0, 20.0, 100.0])
    shape, mean = room**2 / rate, room / slope
    wanted = invgauss.cdf(ahead, mean / shape, scale=shape)
    found = passage_probability(np.array([room]), np.full((1, 4), slope), np.array([rate]), ahead)
    assert found[0] == pytest.approx(wanted)


def test_a_walk_without_drift_reaches_a_limit_as_the_reflection_principle_says() -> None:
    ahead = np.array([1.0, 10.0, 100.0])
    found = passage_probability(np.array([2.0]), np.zeros((1, 3)), np.array([0.5]), ahead)
    assert found[0] == pytest.approx(2.0 * norm.sf(2.0 / np.sqrt(0.5 * ahead)))


def test_at_the_start_only_a_limit_without_room_is_reached() -> None:
    room, ahead = np.array([0.0, -1.0, 1e-300, 1e-90, 1.0]), np.array([0.0, 1e-9, 1.0])
    with np.errstate(all="raise", under="ignore"):
        found = passage_probability(room, np.zeros((5, 3)), np.zeros(5), ahead)
        steep = passage_probability(np.ones(2), np.array([[1e6] * 3, [-1e6] * 3]), np.full(2, 1e-30), ahead)
    assert found.tolist() == [[1.0] * 3] * 3 + [[0.0] * 3] * 2
    assert steep[:, 0].tolist() == [0.0, 0.0]
    assert steep[:, 2] == pytest.approx([1.0, 0.0])


def test_with_two_limits_the_probability_is_a_close_upper_bound() -> None:
    """A walk without slope in the middle: P = 1 - 4/π Σ (-1)^k/(2k + 1) exp(-(2k + 1)² π² t / 8), room and rate 1."""
    ahead = np.array([0.0, 0.5, 1.0, 2.25, 4.0])
    k = np.arange(200)[:, None]
    terms = (-1.0) ** k / (2 * k + 1) * np.exp(-((2 * k + 1) ** 2) * np.pi**2 * ahead[1:] / 8.0)
    exact = 1.0 - 4.0 / np.pi * terms.sum(axis=0)
    one = passage_probability(np.ones(1), np.zeros((1, 5)), np.ones(1), ahead)[0, 1:]
    above = np.minimum(2.0 * one, 1.0) - exact
    assert (above > -1e-9).all()
    assert above.max() < 0.09


def test_a_line_reaches_the_limit_when_it_is_there() -> None:
    found = forecast(2.0 + 0.1 * NIGHTS)
    for probability in (0.05, 0.5, 0.95):
        assert found.nights_to(probability) == pytest.approx(21.0, abs=1.5)
    assert (found.within(15.0), found.within(30.0)) == pytest.approx((0.0, 1.0), abs=0.01)


def test_the_probability_grows_and_the_dates_follow_it() -> None:
    found = forecast(VALUES)
    assert (np.diff(found.probability) >= 0.0).all()
    low, middle, high = (found.nights_to(probability) for probability in (0.05, 0.5, 0.95))
    assert low is not None
    assert middle is not None
    assert low < middle
    assert high is None or middle < high
    assert found.within(middle) == pytest.approx(0.5)
    assert found.horizon == pytest.approx(SPANS_AHEAD * 39.0)
    assert found.within(1e6) == found.probability[-1]
    assert (found.low <= found.middle).all()
    assert (found.middle <= found.high).all()


@pytest.mark.parametrize("scale", [1e-6, 1e3])
def test_the_unit_does_not_matter(scale: float) -> None:
    assert forecast(scale * VALUES, scale * 8.0).probability == pytest.approx(forecast(VALUES).probability, abs=1e-6)


def test_sides_are_equal() -> None:
    up, down = forecast(VALUES, two_sided=True), forecast(-VALUES, two_sided=True)
    assert down.nights_to(0.5) == pytest.approx(up.nights_to(0.5), rel=0.05)
    assert forecast(-VALUES).probability[-1] < 0.01


def test_a_value_that_does_not_move_reaches_nothing() -> None:
    assert forecast(np.full(40, 3.0)).nights_to(0.05) is None
    assert forecast(3.0 + 0.3 * (VALUES - 0.1 * NIGHTS), limit=12.0).within(14.0) < 0.001


def test_an_outlier_counts_for_nothing() -> None:
    spoilt = VALUES.copy()
    spoilt[[12, 30]] += (9.0, -7.0)
    left_out = np.delete(NIGHTS, [12, 30])
    kept = forecast(np.delete(VALUES, [12, 30]), nights=left_out, sigmas=np.ones(38))
    assert forecast(spoilt).probability == pytest.approx(kept.probability)


def test_a_known_step_is_no_drift() -> None:
    stepped = 2.0 + 0.1 * np.sin(NIGHTS) + 3.0 * (NIGHTS >= 25)
    assert forecast(stepped, steps=(25.0,)).within(14.0) < 0.01
    assert forecast(stepped).within(14.0) > forecast(stepped, steps=(25.0,)).within(14.0)


def test_too_few_values_give_no_probability() -> None:
    few = np.arange(MIN_VALUES - 1.0)
    assert forecast_limit(few, few, np.ones(len(few)), 20.0, two_sided=False) is None
    with np.errstate(all="raise"):
        assert forecast_limit([], [], [], 20.0, two_sided=True) is None
    same = np.zeros(12)
    assert forecast_limit(same, np.arange(12.0), np.ones(12), 20.0, two_sided=False) is None


@pytest.mark.parametrize(
    ("nights", "values", "sigmas", "limit"),
    [
        (NIGHTS[:-1], VALUES, np.ones(40), 8.0),
        (NIGHTS, np.where(NIGHTS == 3, np.nan, VALUES), np.ones(40), 8.0),
        (NIGHTS, VALUES, np.zeros(40), 8.0),
        (NIGHTS[::-1], VALUES, np.ones(40), 8.0),
        (NIGHTS, VALUES, np.ones(40), 0.0),
    ],
)
def test_invalid_input_is_refused(nights: np.ndarray, values: np.ndarray, sigmas: np.ndarray, limit: float) -> None:
    with pytest.raises(DataError):
        forecast_limit(nights, values, sigmas, limit, two_sided=False)
