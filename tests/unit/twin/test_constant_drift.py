"""Drift of one error in one direction over the nights: the sums of the nights against dense algebra, its false alarms,
and what becomes of it in the prior of the next night."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest
from measured_set import bar, case_study, measured

from twin.artefact.observations import Observations
from twin.errors import FormatError
from twin.formats.estimate_file import format_estimate, parse_estimate
from twin.identification import Estimate, Options, identify
from twin.identification import drift_trend as module
from twin.identification.drift_trend import (
    MOST_STARTS,
    RATE,
    DriftRates,
    DriftStart,
    DriftTrend,
    NightMeasurement,
)
from twin.identification.jump import jump_evidence, largest_false_alarm, log_mean_ratio
from twin.machine.forward_model import exact_deviation
from twin.monitoring.constant_drift import MIN_NIGHTS
from twin.monitoring.night_fit import NightFit, compare_with_nights_before

SIZE, PARAMETERS, ROWS, WALK, NOISE = 4, 2, 3, 0.1, 0.3
"""Unknowns, of which the first are parameters; measurements a night; standard deviations of walk and noise."""

NO_TREND = DriftTrend()


@dataclass(frozen=True, eq=False)
class LinearNights:
    """Nights of a linear machine: designs (n, r, P) and measurements (n, r)."""

    designs: np.ndarray
    seen: np.ndarray

    @classmethod
    def drawn(cls, rng: np.random.Generator, nights: int, rate: np.ndarray) -> LinearNights:
        designs = rng.normal(size=(nights, ROWS, SIZE))
        truth, seen = rng.normal(size=SIZE), []
        for design in designs:
            truth[:PARAMETERS] += WALK * rng.normal(size=PARAMETERS) + rate
            seen.append(design @ truth + NOISE * rng.normal(size=ROWS))
        return cls(designs, np.array(seen))

    def filtered(self, trend: DriftTrend = NO_TREND) -> tuple[np.ndarray, np.ndarray, DriftTrend]:
        """Return mean, covariance and trend after all nights, by the filter of the nights."""
        mean, covariance = np.zeros(SIZE), np.eye(SIZE)
        everything = np.arange(SIZE)
        for design, seen in zip(self.designs, self.seen, strict=True):
            rates = trend.rates
            if rates is not None:
                rise = np.zeros((SIZE, SIZE))
                rise[:, rates.columns] = rates.cross
                own = np.zeros((SIZE, SIZE))
                own[np.ix_(rates.columns, rates.columns)] = rates.covariance
                mean[rates.columns] += rates.mean
                covariance = covariance + rise + rise.T + own
                trend = replace(trend, rates=rates.predicted(1.0))
            covariance = covariance + np.diag(np.where(everything < PARAMETERS, WALK**2, 0.0))
            inverse = np.linalg.inv(design @ covariance @ design.T + NOISE**2 * np.eye(ROWS))
            score = design.T @ inverse @ (seen - design @ mean)
            information = design.T @ inverse @ design
            measurement = NightMeasurement(score, information, covariance, everything, everything, SIZE, PARAMETERS)
            trend = trend.after_night(measurement, 1.0)
            mean = mean + covariance @ score
            covariance = covariance - covariance @ information @ covariance
        return mean, covariance, trend

    def dense(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the covariance (n r, n r) of all measurements without a drift, the design (n r, m) of rates since the
        first night, and the covariance (P, n r) of the unknowns of the last night with the measurements."""
        count = len(self.designs)
        number = np.arange(1, count + 1)
        steps = np.zeros((SIZE, SIZE))
        steps[:PARAMETERS, :PARAMETERS] = WALK**2 * np.eye(PARAMETERS)
        moved = [[np.eye(SIZE) + min(one, two) * steps for two in number] for one in number]
        whole = np.block(
            [[self.designs[i] @ moved[i][j] @ self.designs[j].T for j in range(count)] for i in range(count)]
        )
        rates = np.concatenate([k * design[:, :PARAMETERS] for k, design in zip(number, self.designs, strict=True)])
        last = np.concatenate([moved[-1][j] @ self.designs[j].T for j in range(count)], axis=1)
        return whole + NOISE**2 * np.eye(count * ROWS), rates, last


def test_the_sums_of_the_nights_are_those_of_all_measurements_together() -> None:
    nights = LinearNights.drawn(np.random.default_rng(1), 5, np.array([0.2, 0.0]))
    first = nights.filtered()[2].starts[0]
    covariance, design, _ = nights.dense()
    seen = nights.seen.reshape(-1)
    assert (first.measured, first.nights) == (5, 5.0)
    assert first.score == pytest.approx(design.T @ np.linalg.solve(covariance, seen))
    assert first.information == pytest.approx(design.T @ np.linalg.solve(covariance, design))


@pytest.mark.parametrize("found_after", [0, 3])
def test_rates_are_unknowns_of_all_nights(found_after: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Unknowns and rates after the last night are those of one fit, whenever the drift was found."""
    monkeypatch.setattr(module, "FADING_NIGHTS", 1e12)
    nights = LinearNights.drawn(np.random.default_rng(2), 6, np.array([0.2, -0.1]))
    columns = np.arange(PARAMETERS)
    begun = LinearNights(nights.designs[:found_after], nights.seen[:found_after])
    start = begun.filtered()[2].starts[0] if found_after else DriftStart.of_size(SIZE, PARAMETERS)
    rates = DriftRates.found(start, columns, 0.01)
    if not found_after:
        mean, z_covariance, trend = nights.filtered(DriftTrend((), rates))
    else:  # the sums of all nights, and of the nights until then with the rest as one filter
        mean, z_covariance, trend = nights.filtered()
        last = DriftRates.found(trend.starts[0], columns, 0.01)
        mean = mean + trend.starts[0].effect @ last.mean
        z_covariance = z_covariance + trend.starts[0].effect @ last.covariance @ trend.starts[0].effect.T
        trend = DriftTrend((), last)
    covariance, design, cross = nights.dense()
    drifting = covariance + RATE**2 * design @ design.T
    last_design = np.zeros((SIZE, PARAMETERS))
    last_design[:PARAMETERS] = len(nights.seen) * np.eye(PARAMETERS)
    z_cross = cross + RATE**2 * last_design @ design.T
    seen = nights.seen.reshape(-1)
    found = trend.rates
    assert found is not None
    assert found.mean == pytest.approx(RATE**2 * design.T @ np.linalg.solve(drifting, seen))
    assert mean == pytest.approx(z_cross @ np.linalg.solve(drifting, seen))
    before = np.eye(SIZE) + RATE**2 * last_design @ last_design.T
    before[:PARAMETERS, :PARAMETERS] += len(nights.seen) * WALK**2 * np.eye(PARAMETERS)
    assert z_covariance == pytest.approx(before - z_cross @ np.linalg.solve(drifting, z_cross.T))
    assert found.information == pytest.approx(design.T @ np.linalg.solve(covariance, design), rel=1e-4)


def test_the_probability_of_a_false_alarm_is_that_stated() -> None:
    rng, chances = np.random.default_rng(3), []
    for _ in range(300):
        starts = LinearNights.drawn(rng, 8, np.zeros(PARAMETERS)).filtered()[2].starts
        evidence = [
            jump_evidence(start.score[[number]], start.information[[number]][:, [number]], RATE)[0]
            for start in starts
            for number in range(PARAMETERS)
        ]
        chances.append(largest_false_alarm(log_mean_ratio(np.array(evidence))))
    assert np.mean(np.array(chances) <= 0.2) <= 0.2
    assert np.mean(np.array(chances) <= 0.05) <= 0.05


def test_the_first_nights_that_are_kept_spread_over_the_past() -> None:
    nights = LinearNights.drawn(np.random.default_rng(4), 40, np.zeros(PARAMETERS))
    ages = [start.nights for start in nights.filtered()[2].starts]
    assert len(ages) == MOST_STARTS
    assert (ages[0], ages[-1]) == (40.0, 1.0)
    assert all(earlier > later for earlier, later in pairwise(ages))
    assert max(earlier / later for earlier, later in pairwise(ages)) < 5.0


def test_rates_that_are_found_later_are_added() -> None:
    trend = LinearNights.drawn(np.random.default_rng(5), 6, np.array([0.2, 0.1])).filtered()[2]
    one = DriftRates.found(trend.starts[0], np.array([0]), 0.01)
    more = DriftRates.found(trend.starts[1], np.array([0, 1]), 0.002)
    both = one.joined(more)
    assert both.columns.tolist() == [0, 1]
    assert both.false_alarm == 0.002
    assert both.nights == one.nights
    assert both.mean[0] == pytest.approx(one.mean[0] + more.mean[0])
    assert np.linalg.eigvalsh(both.covariance).min() > 0.0
    assert trend.without(1).starts[0].effect == pytest.approx(np.delete(trend.starts[0].effect, 1, axis=0))
    assert DriftTrend((), both).without(1).size == SIZE - 1


MODEL, FAMILY = case_study(3)
SIGMA = FAMILY.prior_standard_deviation
BAR = bar(7, sigma_mm=0.8e-3)
TRUTH = FAMILY.draw(np.random.default_rng(5), 1)[0]
FIXED = Options(estimate_scales=False, outliers="none", misfit_mm=0.0005)
STATED = 0.03 * SIGMA


def fused(change: dict[str, float], count: int, rng_seed: int) -> list[tuple[Estimate, NightFit, np.ndarray]]:
    """Fuse `count` nights of a machine that walks as stated, and changes in each night by `change` in mm or rad."""
    rng, truth = np.random.default_rng(rng_seed), TRUTH.copy()

    def night(expression: str) -> Observations:
        def deviation(at: np.ndarray, tool: np.ndarray) -> np.ndarray:
            return exact_deviation(MODEL, at, tool, truth)

        return measured(expression, 2, BAR, deviation, rng, sigma_mm=1e-3)

    estimate = identify(MODEL, night("S1+S2+S3"), BAR, FAMILY, FIXED)
    nights = []
    for _ in range(count):
        truth = truth + STATED * rng.normal(size=MODEL.size)
        for name, value in change.items():
            truth[MODEL.index(name)] += value
        seen = night("S3")
        fit = compare_with_nights_before(FAMILY, seen, BAR, estimate.carried_over(), STATED)
        estimate = identify(MODEL, seen, BAR, FAMILY, replace(FIXED, carried_over=fit.prior))
        nights.append((estimate, fit, truth))
    return nights


@pytest.fixture(scope="module")
def drifting() -> list[tuple[Estimate, NightFit, np.ndarray]]:
    return fused({"B0Z": 0.8e-6}, 14, 6)


def test_a_drift_is_named_with_its_rate(drifting: list[tuple[Estimate, NightFit, np.ndarray]]) -> None:
    told = [number for number, (_, fit, _) in enumerate(drifting, start=1) if fit.drift is not None]
    assert MIN_NIGHTS <= told[0] <= 12
    found = drifting[-1][1].drift
    assert found is not None
    assert found.false_alarm <= 0.01
    suspect = found.suspects[0]
    assert (suspect.error, suspect.unit) == ("B0Z", "µrad")
    assert suspect.probability > 0.9
    assert suspect.rate == pytest.approx(0.8, abs=3.0 * suspect.standard_uncertainty)
    assert suspect.standard_uncertainty < 0.3
    assert suspect.other_direction < 1e-3
    assert f"B0Z by {suspect.rate:+.2g} ± " in found.text
    assert 10.0 <= found.nights <= 14.0


def test_the_estimate_follows_a_drift(drifting: list[tuple[Estimate, NightFit, np.ndarray]]) -> None:
    index = MODEL.index("B0Z")
    for estimate, fit, truth in drifting[-3:]:
        deviation = math.sqrt(estimate.covariance[index, index])
        assert estimate.parameters[index] == pytest.approx(truth[index], abs=3.0 * deviation)
        assert fit.fits
        assert fit.factor < 3.0  # the random walk does not have to explain the drift


def test_rates_move_the_prior_of_the_next_night(drifting: list[tuple[Estimate, NightFit, np.ndarray]]) -> None:
    known = drifting[-1][0].carried_over()
    rates = known.trend.rates
    assert rates is not None
    later = known.after(0.0 * SIGMA, nights=2.0)
    assert later.mean[rates.columns] - known.mean[rates.columns] == pytest.approx(2.0 * rates.mean)
    variances = np.diag(later.covariance) - np.diag(known.covariance)
    own = rates.cross[rates.columns, np.arange(len(rates.columns))]
    own = 4.0 * (np.diag(rates.covariance) + own) + 2.0 * rates.walk_variances
    assert variances[rates.columns] == pytest.approx(own, abs=1e-12)
    assert not later.trend


def test_the_trend_is_kept_in_the_file(drifting: list[tuple[Estimate, NightFit, np.ndarray]]) -> None:
    estimate = drifting[-1][0]
    text = format_estimate(estimate, {})
    stored = parse_estimate(text, "e.json").carried_over().trend
    assert stored.rates is not None
    assert estimate.trend.rates is not None
    assert stored.rates.mean == pytest.approx(estimate.trend.rates.mean, rel=1e-15)
    assert stored.rates.columns.tolist() == estimate.trend.rates.columns.tolist()
    assert len(stored.starts) == len(estimate.trend.starts) > 0
    for one, other in zip(stored.starts, estimate.trend.starts, strict=True):
        assert (one.measured, one.nights) == (other.measured, other.nights)
        assert one.effect == pytest.approx(other.effect, rel=1e-5)
        assert one.information == pytest.approx(other.information, rel=1e-5)


@pytest.mark.parametrize(
    ("part", "value", "key"),
    [
        ("mean", [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0], "trend.rates.mean"),
        ("parameters", ["EQX[1]"], "trend.rates.parameters"),
        ("covariance", [[1.0, 2.0]], "trend.rates.covariance"),
    ],
)
def test_a_damaged_trend_is_refused(
    drifting: list[tuple[Estimate, NightFit, np.ndarray]], part: str, value: list[object], key: str
) -> None:
    document = json.loads(format_estimate(drifting[-1][0], {}))
    document["carried_over"]["trend"]["rates"][part] = value
    with pytest.raises(FormatError) as refused:
        parse_estimate(json.dumps(document), "e.json")
    assert key in str(refused.value)


def test_a_machine_that_walks_as_stated_shows_no_drift() -> None:
    for seed in (7, 8, 9):
        assert [fit.drift for _, fit, _ in fused({}, 8, seed)] == [None] * 8
