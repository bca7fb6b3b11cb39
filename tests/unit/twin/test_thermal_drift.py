"""Drift explained by temperatures, against arithmetic that is written out here and machines drawn by hand."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import multivariate_t

from twin.errors import DataError
from twin.monitoring.drift_evidence import MIN_NIGHTS, RIDGES, WALKS, DriftDirection, NightlyDrift
from twin.monitoring.seen_directions import SeenDirections, own_measurement
from twin.monitoring.sensor_screening import screen_sensors
from twin.monitoring.thermal_drift import NightEstimate, explain_thermal_drift
from twin.monitoring.thermal_regression import explain_drift

NIGHTS = 40


def drift(
    values: np.ndarray, temperatures: np.ndarray, variances: np.ndarray | None = None, steps: tuple[float, ...] = ()
) -> NightlyDrift:
    days = np.arange(float(len(values)))
    return NightlyDrift(days, values, np.ones_like(values) if variances is None else variances, temperatures, steps)


def weather(rng: np.random.Generator, count: int, sensors: int) -> np.ndarray:
    """Independent temperatures that forget themselves within a few days."""
    found = np.zeros((count, sensors))
    for night in range(1, count):
        found[night] = 0.7 * found[night - 1] + rng.standard_normal(sensors)
    return 20.0 + found


class TestEvidence:
    def test_it_is_that_of_a_student_t_distribution(self) -> None:
        """Differences of two models, against the density of contrasts that scipy gives."""
        rng = np.random.default_rng(1)
        temperatures, y = weather(rng, 12, 2), rng.standard_normal(12)
        given = drift(y[:, None], temperatures)
        found = DriftDirection.of(given, 0)
        assert found is not None
        contrasts = np.linalg.svd(np.ones((1, 12)))[2][1:]  # free of the level
        x = (temperatures - temperatures.mean(axis=0)) / np.sqrt(
            np.mean((temperatures - temperatures.mean(axis=0)) ** 2)
        )

        def log_density(q: float, g: float, chosen: list[int]) -> float:
            days = np.arange(12.0)
            v = np.eye(12) + q * np.minimum.outer(days, days) + g * x[:, chosen] @ x[:, chosen].T
            scale = contrasts @ v @ contrasts.T
            # With the prior 1/σ² the density of the contrasts is |S|^-½ (cᵀS⁻¹c)^-m/2 up to a constant.
            c = contrasts @ y
            return float(-0.5 * np.linalg.slogdet(scale)[1] - 0.5 * len(c) * np.log(c @ np.linalg.solve(scale, c)))

        none = found.log_evidence(())[:, 0]
        both = found.log_evidence((0, 1))
        for walk in (0, 3, 7):
            assert none[walk] - none[0] == pytest.approx(log_density(WALKS[walk], 0.0, []) - log_density(0.0, 0.0, []))
            for ridge in (0, 4):
                difference = both[walk, ridge] - none[walk]
                expected = log_density(WALKS[walk], RIDGES[ridge], [0, 1]) - log_density(WALKS[walk], 0.0, [])
                assert difference == pytest.approx(expected)

    def test_the_density_of_the_contrasts_is_a_limit_of_the_t_distribution(self) -> None:
        """The formula above, against scipy: a proper prior of the variance with few degrees of freedom."""
        scale = np.array([[2.0, 0.3], [0.3, 1.0]])
        points = np.array([[1.0, 0.5], [-2.0, 1.0]])
        nu: Any = 1e-9
        densities = [multivariate_t(shape=nu * scale, df=nu).logpdf(point) for point in points]
        squares = [point @ np.linalg.solve(scale, point) for point in points]
        assert densities[0] - densities[1] == pytest.approx(-np.log(squares[0] / squares[1]), rel=1e-5)


class TestSensors:
    def test_the_one_that_explains_is_taken_and_its_effect_found(self) -> None:
        rng = np.random.default_rng(2)
        temperatures = weather(rng, NIGHTS, 3)
        effects = np.array([1.5, 0.0, -0.8, 0.0])
        values = temperatures[:, [1]] * effects + 0.3 * np.cumsum(rng.standard_normal((NIGHTS, 4)), axis=0)
        found = explain_drift(drift(values + rng.standard_normal((NIGHTS, 4)), temperatures))
        assert found.taken == (1,)
        sigmas = np.sqrt(found.covariances[:, 1, 1])
        assert (np.abs(found.coefficients[:, 1] - effects) < 3.0 * sigmas).all()
        assert np.nanmean(found.left_out**2) < 0.8 * np.nanmean(found.left_out_without**2)

    def test_two_that_show_the_same_stay_finite_and_one_is_enough(self) -> None:
        rng = np.random.default_rng(3)
        one = weather(rng, NIGHTS, 1)
        temperatures = np.hstack([one, one, one + 1e-9 * rng.standard_normal(one.shape)])
        values = 2.0 * one + rng.standard_normal((NIGHTS, 1))
        found = explain_drift(drift(values, temperatures))
        assert len(found.taken) == 1
        together = found.coefficients.sum(axis=1)
        assert together == pytest.approx([2.0], abs=0.5)
        same, sigma = np.ones(3), 0.0 * np.ones(3)
        apart = np.array([1.0, -1.0, 0.0])
        assert found.change(apart, sigma)[1][0] > 4.0 * found.change(same, sigma)[1][0]

    def test_wandering_that_has_nothing_to_do_with_temperature_is_not_explained(self) -> None:
        """Random walks of both: an ordinary regression finds nearly all of them significant."""
        taken = 0
        for seed in range(20):
            rng = np.random.default_rng([4, seed])
            temperatures = 20.0 + np.cumsum(rng.standard_normal((NIGHTS, 4)), axis=0)
            values = np.cumsum(rng.standard_normal((NIGHTS, 3)), axis=0) + 0.2 * rng.standard_normal((NIGHTS, 3))
            taken += bool(explain_drift(drift(values, temperatures)).taken)
        assert taken <= 1

    def test_a_known_step_is_no_drift(self) -> None:
        rng = np.random.default_rng(5)
        temperatures = weather(rng, NIGHTS, 1)
        values = temperatures * 1.0 + 0.5 * rng.standard_normal((NIGHTS, 1))
        values[20:] += 40.0
        found = explain_drift(drift(values, temperatures, steps=(20.0,)))
        assert found.taken == (0,)
        assert found.coefficients[0, 0] == pytest.approx(1.0, abs=0.25)
        assert found.walk[0] < 1.0

    def test_nights_that_did_not_see_a_direction_do_not_count(self) -> None:
        rng = np.random.default_rng(6)
        temperatures = weather(rng, NIGHTS, 1)
        values = np.hstack([temperatures, temperatures]) + 0.3 * rng.standard_normal((NIGHTS, 2))
        variances = np.ones_like(values)
        variances[::2, 1] = np.inf
        values[::2, 1] = np.nan
        found = explain_drift(drift(values, temperatures, variances))
        assert found.coefficients[:, 0] == pytest.approx([1.0, 1.0], abs=0.3)
        assert np.isnan(found.left_out[::2, 1]).all()

    def test_more_days_and_kelvins_are_more_uncertain(self) -> None:
        rng = np.random.default_rng(7)
        temperatures = weather(rng, NIGHTS, 2)
        values = temperatures[:, :1] + np.cumsum(rng.standard_normal((NIGHTS, 1)), axis=0)
        found = explain_drift(drift(values, temperatures))
        none, sigma = np.zeros(2), np.zeros(2)
        assert found.change(none, sigma, 2.0)[1][0] == pytest.approx(2.0 * found.change(none, sigma, 1.0)[1][0])
        assert found.change([3.0, 3.0], sigma)[1][0] == pytest.approx(9.0 * found.change([1.0, 1.0], sigma)[1][0])
        assert found.change(none, [0.5, 0.0])[1][0] == pytest.approx(0.25 * found.coefficients[0, 0] ** 2)

    def test_too_few_nights_are_refused(self) -> None:
        with pytest.raises(DataError, match=f"{MIN_NIGHTS - 1} nights"):
            drift(np.zeros((MIN_NIGHTS - 1, 1)), np.zeros((MIN_NIGHTS - 1, 1)))


class TestDirections:
    def test_they_are_independent_before_and_after_and_ordered(self) -> None:
        rng = np.random.default_rng(8)
        rows = rng.normal(size=(6, 6))
        before = np.diag(rng.uniform(1.0, 9.0, 6))
        after = np.linalg.inv(np.linalg.inv(before) + rows.T @ rows)
        found = SeenDirections.of(after, before)
        assert found.analysis @ after @ found.analysis.T == pytest.approx(np.eye(len(found.gains)), abs=1e-9)
        assert found.analysis @ before @ found.analysis.T == pytest.approx(np.diag(found.gains), rel=1e-9, abs=1e-9)
        assert found.analysis @ found.synthesis == pytest.approx(np.eye(len(found.gains)), abs=1e-9)
        assert (np.diff(found.gains) <= 0.0).all()

    def test_parameters_that_the_family_holds_at_zero_have_no_part(self) -> None:
        found = SeenDirections.of(np.diag([1.0, 0.0, 1.0]), np.diag([100.0, 0.0, 50.0]))
        assert found.gains == pytest.approx([100.0, 50.0])
        assert (found.synthesis[1] == 0.0).all()

    def test_a_measurement_that_tells_nothing_is_refused(self) -> None:
        with pytest.raises(DataError, match="no error"):
            SeenDirections.of(np.eye(2), 2.0 * np.eye(2))

    def test_the_own_measurement_of_a_fused_night_is_found_again(self) -> None:
        prior, r, y = np.array([4.0, 9.0]), np.array([1.0, 1e6]), np.array([5.0, 7.0])
        c = 1.0 / (1.0 / prior + 1.0 / r)
        u = c * (1.0 / prior + y / r)
        value, variance = own_measurement(u, c, np.ones(2), prior)
        assert (value[0], variance[0]) == (pytest.approx(5.0), pytest.approx(1.0))
        assert np.isnan(value[1])
        assert np.isinf(variance[1])


class TestScreening:
    def readings(self) -> np.ndarray:
        return weather(np.random.default_rng(9), NIGHTS, 4)

    def verdicts(self, readings: np.ndarray) -> list[str]:
        found = screen_sensors(("a", "b", "c", "d"), readings, np.full_like(readings, 0.1))
        return [one.reason for one in found.verdicts]

    def test_good_sensors_pass(self) -> None:
        assert self.verdicts(self.readings()) == ["", "", "", ""]

    def test_a_stuck_one_is_named_with_its_value(self) -> None:
        readings = self.readings()
        readings[25:, 2] = readings[25, 2]
        assert self.verdicts(readings)[2] == f"stuck at {readings[25, 2]:.2f} °C for 15 nights"

    def test_one_that_stuck_for_a_while_loses_those_nights(self) -> None:
        readings = self.readings()
        readings[10:14, 2] = readings[10, 2]
        found = screen_sensors(("a", "b", "c", "d"), readings, np.full_like(readings, 0.1))
        assert found.verdicts[2].usable
        assert found.verdicts[2].left_out == 3

    def test_all_that_stand_still_together_are_not_stuck(self) -> None:
        readings = self.readings()
        readings[10:14] = readings[10]
        assert self.verdicts(readings) == ["", "", "", ""]

    def test_a_single_jump_is_left_out(self) -> None:
        readings = self.readings()
        readings[12, 1] += 15.0
        found = screen_sensors(("a", "b", "c", "d"), readings, np.full_like(readings, 0.1))
        assert found.verdicts[1].usable
        assert np.isnan(found.readings_c[12, 1])
        assert np.isnan(found.readings_c).sum() == 1

    def test_one_that_came_off_is_named(self) -> None:
        readings = self.readings()
        readings[20:, 3] -= 15.0
        assert "stayed there" in self.verdicts(readings)[3]

    def test_a_hall_that_cools_down_is_no_jump(self) -> None:
        readings = self.readings()
        readings[20:] -= 12.0
        assert self.verdicts(readings) == ["", "", "", ""]

    @pytest.mark.parametrize("wrong", [np.nan, np.inf, -273.0, 850.0])
    def test_a_sensor_that_fails_is_missing(self, wrong: float) -> None:
        readings = self.readings()
        readings[::2, 0] = wrong
        assert self.verdicts(readings)[0] == "usable readings in only 20 of 40 nights"

    def test_a_constant_one_is_named(self) -> None:
        readings = self.readings()
        readings[:, 1] = 20.0 + 0.1 * np.sin(np.arange(NIGHTS))
        assert self.verdicts(readings)[1].startswith("constant")


class TestNights:
    def nights(self, temperatures: np.ndarray) -> list[NightEstimate]:
        """Two errors in µm: the first grows by 2 per K of the first sensor."""
        rng = np.random.default_rng(10)
        sigmas = np.full(temperatures.shape[1], 0.05)
        return [
            NightEstimate(float(k), [2.0 * row[0], 1.0] + 0.2 * rng.standard_normal(2), 0.04 * np.eye(2), row, sigmas)
            for k, row in enumerate(temperatures)
        ]

    def test_the_change_is_that_of_the_machine(self) -> None:
        temperatures = weather(np.random.default_rng(11), NIGHTS, 2)
        found = explain_thermal_drift(self.nights(temperatures), ("ram", "other"), 25.0 * np.eye(2))
        assert found.taken == ("ram",)
        mean, covariance = found.change([20.0, 20.0], [23.0, np.nan], 0.5)
        assert mean[0] == pytest.approx(6.0, abs=3.0 * np.sqrt(covariance[0, 0]))
        assert mean == pytest.approx([6.0, 0.0], abs=0.4)

    def test_farther_than_a_fifth_of_the_range_outside_is_extrapolated(self) -> None:
        temperatures = weather(np.random.default_rng(11), NIGHTS, 2)
        found = explain_thermal_drift(self.nights(temperatures), ("ram", "other"), 25.0 * np.eye(2))
        lowest, highest = temperatures.min(axis=0), temperatures.max(axis=0)
        assert found.learned_c[0] == pytest.approx(lowest)
        assert found.learned_c[1] == pytest.approx(highest)
        width = highest - lowest
        assert found.extrapolated(highest + 0.19 * width) == found.extrapolated(lowest - 0.19 * width) == ()
        assert found.extrapolated(highest + [0.19, 0.21] * width) == (1,)
        assert found.extrapolated(lowest - 0.21 * width) == (0, 1)
        assert found.extrapolated([np.nan, highest[1]]) == ()

    def test_nothing_is_learned_from_a_night_whose_prior_is_not_known(self) -> None:
        temperatures = weather(np.random.default_rng(11), NIGHTS, 2)
        nights = self.nights(temperatures)
        nights[5] = replace(nights[5], parameters=nights[5].parameters + 50.0, separable=False)
        found = explain_thermal_drift(nights, ("ram", "other"), 25.0 * np.eye(2))
        assert found.nights.tolist() == [night for night in range(NIGHTS) if night != 5]
        assert found.coefficients[0][0, 0] == pytest.approx(2.0, abs=0.2)

    def test_a_missing_temperature_of_an_explaining_sensor_is_refused(self) -> None:
        temperatures = weather(np.random.default_rng(11), NIGHTS, 2)
        found = explain_thermal_drift(self.nights(temperatures), ("ram", "other"), 25.0 * np.eye(2))
        with pytest.raises(DataError, match="sensor ram"):
            found.change([20.0, 20.0], [np.nan, 20.0], 0.5)

    def test_what_cannot_be_explained_is_refused_in_words(self) -> None:
        temperatures = weather(np.random.default_rng(12), NIGHTS, 1)
        with pytest.raises(DataError, match="no temperature sensor"):
            explain_thermal_drift(self.nights(temperatures), (), np.eye(2))
        with pytest.raises(DataError, match="7 nights"):
            explain_thermal_drift(self.nights(temperatures)[:7], ("ram",), 25.0 * np.eye(2))
        with pytest.raises(DataError, match="ram constant"):
            explain_thermal_drift(
                self.nights(np.full((NIGHTS, 1), 20.0) + 0.01 * temperatures), ("ram",), 25.0 * np.eye(2)
            )
