"""Trends compared with independent arithmetic: closed forms by hand, brute force, and long runs of random numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest

from twin.errors import DataError
from twin.monitoring import ewma_chart, find_steps, fit_drift, individuals_chart, limit_crossing
from twin.monitoring.control_chart import EWMA_LIMIT_WIDTH, EWMA_WEIGHT


class TestControlCharts:
    def test_limits_by_hand(self) -> None:
        """Use moving ranges 2, 1, 3, mean 2; sigma 2 / 1.128; centre 11.5 (Montgomery's constant d2)."""
        chart = individuals_chart([10.0, 12.0, 11.0, 14.0])
        assert chart.centre == pytest.approx(11.75)
        assert chart.sigma == pytest.approx(2.0 / 1.128, rel=1e-3)
        assert chart.upper == pytest.approx(11.75 + 2.66 * 2.0, rel=1e-3)
        assert chart.lower == pytest.approx(11.75 - 2.66 * 2.0, rel=1e-3)
        assert chart.outside == ()

    def test_a_wild_value_is_outside(self) -> None:
        values = [0.0, 1.0] * 10 + [9.0]
        assert individuals_chart(values).outside == (20,)

    def test_ewma_by_hand(self) -> None:
        """Check z1 = 0.2·2, z2 = 0.2·(-1) + 0.8·0.4; var z1 = w²σ², var z2 = w²(1 + (1 - w)²)σ²."""
        found = ewma_chart([2.0, -1.0, 0.0], 0.0, 1.0)
        assert found.values == pytest.approx([0.4, 0.12, 0.096])
        assert found.upper[0] == pytest.approx(EWMA_LIMIT_WIDTH * EWMA_WEIGHT)
        assert found.upper[1] == pytest.approx(EWMA_LIMIT_WIDTH * EWMA_WEIGHT * math.sqrt(1.0 + 0.8**2))

    def test_one_false_alarm_in_five_hundred(self) -> None:
        """Compute the average run length without a shift as a Markov chain with steady limits.

        Brook & Evans, Biometrika 59, 1972.
        """
        cells, half = 401, EWMA_LIMIT_WIDTH * math.sqrt(EWMA_WEIGHT / (2.0 - EWMA_WEIGHT))
        edges = np.linspace(-half, half, cells + 1)
        middle = 0.5 * (edges[1:] + edges[:-1])
        cumulative = np.vectorize(lambda x: 0.5 * math.erfc(-x / math.sqrt(2.0)))(
            (edges[None, :] - (1.0 - EWMA_WEIGHT) * middle[:, None]) / EWMA_WEIGHT
        )
        lengths = np.linalg.solve(np.eye(cells) - np.diff(cumulative, axis=1), np.ones(cells))
        assert lengths[cells // 2] == pytest.approx(500.0, rel=0.02)

    @pytest.mark.parametrize("values", [[1.0, 2.0], [1.0, math.nan, 2.0]])
    def test_too_little_is_refused(self, values: list[float]) -> None:
        with pytest.raises(DataError):
            individuals_chart(values)


class TestDrift:
    def test_a_line_through_three_points_by_hand(self) -> None:
        """Use equal weights u = 1: slope variance 1 / Σ(t - t̄)² = 1/2; level at the end: mean + slope, 1/3 + 1/2."""
        drift = fit_drift([0.0, 1.0, 2.0], [1.0, 3.0, 5.0], [1.0, 1.0, 1.0])
        assert (drift.level, drift.slope) == pytest.approx((5.0, 2.0))
        assert drift.slope_sigma == pytest.approx(math.sqrt(0.5))
        assert drift.level_sigma == pytest.approx(math.sqrt(5.0 / 6.0))
        assert drift.factor == pytest.approx(1.96, abs=1e-3)

    def test_weights_by_hand(self) -> None:
        """Use two exact points, which decide because the third is a hundred times less certain."""
        drift = fit_drift([0.0, 1.0, 2.0], [0.0, 1.0, 12.0], [0.01, 0.01, 1.0])
        assert drift.slope == pytest.approx(1.0, abs=4e-3)

    def test_scatter_decides_where_stated_uncertainty_is_common_to_all(self) -> None:
        """Check that contributions common to all nights do not enlarge the residuals of a trend.

        Sigmas of 5 µm, residuals of 0.1 µm, slope known to 0.01.
        """
        rng = np.random.default_rng(1)
        nights = np.arange(20.0)
        drift = fit_drift(nights, 3.0 + 0.4 * nights + rng.normal(0.0, 0.1, 20), np.full(20, 5.0))
        by_hand = 0.1 / math.sqrt(np.sum((nights - nights.mean()) ** 2))
        assert drift.slope_sigma == pytest.approx(by_hand, rel=0.6)
        assert drift.slope == pytest.approx(0.4, abs=3.0 * by_hand)
        assert drift.significant

    def test_the_band_holds_the_truth_as_often_as_it_says(self) -> None:
        rng = np.random.default_rng(2)
        nights = np.arange(12.0)
        held = 0
        for _ in range(800):
            drift = fit_drift(nights, 0.3 * nights + rng.normal(size=12), np.ones(12))
            held += abs(drift.slope - 0.3) <= drift.factor * drift.slope_sigma
        assert 0.93 <= held / 800 <= 1.0

    def test_a_step_is_not_smeared_into_the_slope(self) -> None:
        nights = np.arange(10.0)
        values = 0.5 * nights + np.where(nights >= 6.0, 20.0, 0.0)
        drift = fit_drift(nights, values, np.ones(10), [6.0])
        assert drift.slope == pytest.approx(0.5)
        assert drift.steps[0][:2] == pytest.approx((6.0, 20.0))
        assert drift.level == pytest.approx(24.5)

    @pytest.mark.parametrize("seed", range(10))
    def test_it_is_that_of_the_whole_least_squares_solution(self, seed: int) -> None:
        """Four nights between the steps on average; the uncertainties are those of the inverse normal matrix."""
        rng = np.random.default_rng(seed)
        nights = np.sort(rng.choice(np.arange(60.0), 40))
        sigmas = rng.uniform(0.5, 2.0, 40)
        values = 0.2 * nights + sigmas * rng.normal(size=40)
        steps = find_steps(nights, values, sigmas, rng.choice(nights, 10).tolist())
        drift = fit_drift(nights, values, sigmas, steps)
        design = np.stack([np.ones(40), nights - nights[-1], *(-(nights < at).astype(float) for at in steps)], axis=1)
        rows = design / sigmas[:, None]
        found = np.linalg.lstsq(rows, values / sigmas, rcond=None)[0]
        inflation = drift.scatter**2 * (1.0 + drift.correlation) / (1.0 - drift.correlation)
        covariance = np.linalg.inv(rows.T @ rows) * inflation
        assert drift.scatter == pytest.approx(np.linalg.norm(values / sigmas - rows @ found) / math.sqrt(drift.freedom))
        assert [drift.level, drift.slope, *(size for _, size, _ in drift.steps)] == pytest.approx(found)
        sizes = [sigma for _, _, sigma in drift.steps]
        assert [drift.level_sigma, drift.slope_sigma, *sizes] == pytest.approx(np.sqrt(np.diagonal(covariance)))
        assert drift.covariance == pytest.approx(covariance[0, 1])
        assert drift.fitted == pytest.approx(design @ found)
        back = np.array([0.0, -7.0])
        assert drift.line_sigma(back)[1] ** 2 == pytest.approx(np.array([1.0, -7.0]) @ covariance[:2, :2] @ [1.0, -7.0])

    def test_what_cannot_be_told_apart_is_refused(self) -> None:
        with pytest.raises(DataError):
            fit_drift([0.0, 1.0], [0.0, 1.0], [1.0, 1.0], [1.0])

    def test_nights_in_disorder_are_refused(self) -> None:
        with pytest.raises(DataError):
            fit_drift([1.0, 0.0], [0.0, 1.0], [1.0, 1.0])


def dense_design(t: np.ndarray, steps: Sequence[float]) -> np.ndarray:
    return np.stack([np.ones_like(t), t, *((t >= at).astype(float) for at in steps)], axis=1)


def steps_of_dense_solutions(t: np.ndarray, y: np.ndarray, u: np.ndarray, known: Sequence[float]) -> tuple[float, ...]:
    """Search for steps as `find_steps` does, with a dense least-squares solution for each candidate."""
    steps: list[float] = []
    for at in sorted(set(known)):
        design = dense_design(t, [*steps, at])
        if len(t) > design.shape[1] and np.linalg.matrix_rank(design) == design.shape[1]:
            steps.append(at)
    relative = u / np.median(u)
    differences = np.diff(y / relative)
    noise = np.median(np.abs(differences - np.median(differences))) / 0.9539
    sigmas = relative * max(noise, 1e-3 * np.median(u))
    penalty = 6.0 * np.log(len(t)) * len(t) / (len(t) - 5.0)

    def square(kept: np.ndarray, on: Sequence[float]) -> float:
        rows = dense_design(t, on)[kept] / sigmas[kept, None]
        left = y[kept] / sigmas[kept] - rows @ np.linalg.lstsq(rows, y[kept] / sigmas[kept], rcond=None)[0]
        return float(left @ left)

    def gain(kept: np.ndarray, at: float) -> float:
        return square(kept, steps) - square(kept, [*steps, at])

    everything = np.arange(len(t))
    for _ in range(5 + len(known) - len(steps)):
        levels = np.digitize(t, steps)
        candidates = [
            at
            for at in np.unique(t)
            for same in [levels == np.digitize(at, steps)]
            if np.sum(same & (t < at)) >= 2 and np.sum(same & (t >= at)) >= 2
        ]
        best = None
        for at in sorted(candidates, key=lambda at: -gain(everything, at)):
            if gain(everything, at) < penalty:
                break
            if all(gain(np.delete(everything, index), at) >= penalty for index in everything):
                best = float(at)
                break
        if best is None:
            break
        steps = sorted([*steps, best])
    return tuple(steps)


class TestSteps:
    def test_a_series_without_a_step_seldom_shows_one(self) -> None:
        rng = np.random.default_rng(3)
        found = [bool(find_steps(np.arange(15.0), 0.4 * np.arange(15.0) + rng.normal(size=15), np.ones(15)))]
        for _ in range(299):
            values = 0.4 * np.arange(15.0) + rng.normal(size=15)
            found.append(bool(find_steps(np.arange(15.0), values, np.ones(15))))
        assert np.mean(found) < 0.04

    def test_two_collisions_are_found_where_they_were(self) -> None:
        rng = np.random.default_rng(4)
        nights = np.arange(30.0)
        values = 0.1 * nights + rng.normal(0.0, 0.3, 30) + 5.0 * (nights >= 9) - 8.0 * (nights >= 21)
        assert find_steps(nights, values, np.ones(30)) == (9.0, 21.0)

    def test_one_wild_night_is_no_step(self) -> None:
        rng = np.random.default_rng(5)
        values = rng.normal(0.0, 0.1, 20)
        values[-1] += 3.0
        assert find_steps(np.arange(20.0), values, np.ones(20)) == ()

    @pytest.mark.parametrize("seed", range(40))
    def test_they_are_those_of_whole_least_squares_solutions(self, seed: int) -> None:
        """Compute every gain from two dense solutions, also for the values without one of them."""
        rng = np.random.default_rng(seed)
        count = int(rng.integers(8, 32))
        nights = np.sort(rng.choice(np.arange(1.5 * count), count))  # several runs in some nights
        sigmas = rng.uniform(0.5, 2.0, count)
        values = 0.1 * nights + sigmas * rng.normal(size=count)
        for at in rng.choice(nights, int(rng.integers(1, 4))):
            values += rng.normal(0.0, 8.0) * (nights >= at)
        known = sorted(rng.choice(nights, int(rng.integers(0, 4))).tolist())
        assert find_steps(nights, values, sigmas, known) == steps_of_dense_solutions(nights, values, sigmas, known)

    def test_known_steps_are_kept_where_they_can_be(self) -> None:
        assert find_steps([0.0, 1.0, 2.0, 3.0], [0.0, 0.0, 5.0, 5.0], np.ones(4), [2.0, 0.0]) == (2.0,)


class TestCrossing:
    def test_nine_nights_by_hand(self) -> None:
        """Use 8.4 µm now, 0.4 per night, tolerance 12: nine nights; a line without scatter has no band."""
        nights = np.arange(10.0)
        drift = fit_drift(nights, 4.8 + 0.4 * nights, np.full(10, 1e-9))
        found = limit_crossing(drift, 12.0, 1000.0, two_sided=False)
        assert found.expected == pytest.approx(9.0, abs=1e-6)
        assert found.earliest == pytest.approx(9.0, abs=1e-6)

    def test_the_band_is_earlier_and_solves_its_equation(self) -> None:
        drift = fit_drift([0.0, 1.0, 2.0, 3.0], [0.0, 1.0, 2.0, 3.0], [0.1] * 4)
        found = limit_crossing(drift, 10.0, 1000.0, two_sided=False)
        assert found.expected == pytest.approx(7.0)
        value, sigma = drift.predict(found.earliest)
        assert value + drift.factor * sigma == pytest.approx(10.0)
        assert found.earliest < 7.0

    def test_either_side_counts_for_a_parameter(self) -> None:
        drift = fit_drift([0.0, 1.0, 2.0], [0.0, -1.0, -2.0], [1e-9] * 3)
        assert limit_crossing(drift, 5.0, 100.0, two_sided=True).expected == pytest.approx(3.0)
        assert limit_crossing(drift, 5.0, 100.0, two_sided=False).expected == math.inf

    def test_reached_is_nought(self) -> None:
        drift = fit_drift([0.0, 1.0, 2.0], [0.0, 1.0, 2.0], [0.1] * 3)
        assert limit_crossing(drift, 1.0, 100.0, two_sided=False).reached
