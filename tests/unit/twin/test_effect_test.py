"""Test of the effect of a table: forecast and verdict agree, and it is as often wrong as stated."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.arrays import Array
from twin.artefact.effect_test import CRITICAL, REQUIRED_POWER, EffectTest, expected_power
from twin.artefact.held_out_check import HeldOutCovariance

BALLS = 7
SIZE = 3 * BALLS
RUNS = 1_500
MAX_CHI2 = 2.0


def covariance(rng: np.random.Generator, touch: float, certificate: float, field: float) -> HeldOutCovariance:
    """Random covariances with the given mean standard deviations of a coordinate, and no pose."""

    def drawn(size: float) -> Array:
        shape = rng.normal(size=(SIZE, SIZE))
        return np.asarray(size**2 * shape @ shape.T / SIZE)

    return HeldOutCovariance(np.eye(SIZE), touch**2 * np.eye(SIZE), drawn(certificate), drawn(field))


def effect_tests() -> st.SearchStrategy[tuple[EffectTest, Array]]:
    def build(seed: int, sizes: tuple[float, float, float], step: float, noise: float) -> tuple[EffectTest, Array]:
        rng = np.random.default_rng(seed)
        residuals = covariance(rng, *sizes)
        change = step * rng.normal(size=SIZE)
        return EffectTest.of(change, residuals, residuals.touches, noise, MAX_CHI2), change

    size = st.floats(0.1, 3.0)
    return st.builds(
        build, st.integers(0, 1000), st.tuples(size, size, size), st.floats(0.01, 30.0), st.floats(0.5, 2.0)
    )


@given(effect_tests())
def test_what_is_foreseen_is_accepted_if_the_measurement_is_as_expected(made: tuple[EffectTest, Array]) -> None:
    test, change = made
    former, nothing = -change.reshape(-1, 3), np.zeros((BALLS, 3))
    effect = test.measured(former, nothing)
    assert effect.change == pytest.approx(1.0)
    assert effect.gain == pytest.approx(1.0)
    assert test.power(former) == pytest.approx(test.expected_power(0.0) or test.power(former))
    if test.power(former) >= REQUIRED_POWER:
        assert effect.accepted
        assert effect.limit < 0.5
    if not effect.accepted:
        assert test.expected_power(0.0) == 0.0
    # a table without effect, and one with the wrong sign, as expected
    assert not test.measured(former, former).accepted
    assert not test.measured(former, 2.0 * former).accepted
    assert not test.measured(nothing, former).accepted


@given(effect_tests(), st.floats(0.1, 10.0))
def test_the_unit_does_not_matter(made: tuple[EffectTest, Array], unit: float) -> None:
    test, change = made
    one = test.residuals
    scaled = HeldOutCovariance(one.basis, *(unit**2 * part for part in (one.touches, one.certificate, one.field)))
    other = EffectTest.of(unit * change, scaled, scaled.touches, 1.0, MAX_CHI2)
    same = EffectTest.of(change, one, one.touches, 1.0, MAX_CHI2)
    assert other.limit == pytest.approx(same.limit)
    assert other.expected_power(0.3) == pytest.approx(same.expected_power(0.3))


def test_an_unchanged_table_can_never_be_shown() -> None:
    residuals = covariance(np.random.default_rng(1), 0.5, 0.5, 0.5)
    test = EffectTest.of(np.zeros(SIZE), residuals, residuals.touches, 1.0, MAX_CHI2)
    assert test.expected_power(0.0) == test.power(np.ones((BALLS, 3))) == 0.0
    assert not test.measured(np.ones((BALLS, 3)), np.zeros((BALLS, 3))).accepted


@pytest.mark.parametrize("step", [0.5, 1.0, 2.0])
def test_errors_of_both_kinds_are_as_rare_as_stated(step: float) -> None:
    """Machines are drawn about the estimate, and tables that work, have no effect or act with the wrong sign are
    measured."""
    rng = np.random.default_rng(round(10 * step))
    residuals = covariance(rng, 0.5, 0.4, 0.6)
    change = step * rng.normal(size=SIZE)
    test = EffectTest.of(change, residuals, residuals.touches, 1.0, MAX_CHI2)
    left = rng.multivariate_normal(np.zeros(SIZE), residuals.certificate + residuals.field, RUNS)
    before, after = (left + 0.5 * rng.normal(size=(RUNS, SIZE)) for _ in range(2))
    # r₀ = left - d, r₁ = r₀ + β d
    shares = {}
    for effect in (1.0, 0.0, -1.0):
        found = [
            (test.power(one.reshape(-1, 3)) >= REQUIRED_POWER, test.measured(one.reshape(-1, 3), two.reshape(-1, 3)))
            for one, two in zip(before - change, after + (effect - 1.0) * change, strict=True)
        ]
        shares[effect] = np.mean([written and measured.accepted for written, measured in found])
        if effect == 0.0:
            assert np.mean([measured.change >= measured.limit for _, measured in found]) == pytest.approx(
                0.05, abs=0.018
            )
    assert shares[0.0] <= 0.05 + 0.018
    assert shares[-1.0] == 0.0
    foreseen = np.mean([test.expected_power(deviate) for deviate in rng.normal(size=1_000)])
    assert shares[1.0] == pytest.approx(foreseen, abs=0.05)


def test_the_expected_power_is_the_mean_over_the_tables() -> None:
    rng = np.random.default_rng(3)
    residuals = covariance(rng, 0.5, 0.4, 0.6)
    shape = rng.normal(size=(SIZE, SIZE)) / np.sqrt(SIZE)
    powers = [expected_power(size**2 * shape @ shape.T, residuals, MAX_CHI2) for size in (0.0, 0.5, 1.0, 4.0)]
    assert powers == sorted(powers)
    assert powers[0] == 0.0
    assert powers[-1] > REQUIRED_POWER
    assert powers == [expected_power(size**2 * shape @ shape.T, residuals, MAX_CHI2) for size in (0.0, 0.5, 1.0, 4.0)]


def test_the_level_is_five_per_cent() -> None:
    draws = np.random.default_rng(0).normal(size=100_000)
    assert np.mean(draws > CRITICAL) == pytest.approx(0.05, abs=0.003)
