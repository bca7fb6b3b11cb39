"""Proofs of tables on foreign machines: tables without effect or with the wrong sign are found out, and those that work
are accepted as often as foreseen."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
import pytest

from campaigns.foreign.artefact import S3, MeasuringConditions, measure, measure_at, tilted_bar
from campaigns.foreign.machine import TOOL, foreign_machine
from campaigns.foreign.score import family_of
from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.effect_test import REQUIRED_POWER, EffectTest
from twin.artefact.held_out_check import (
    HeldOutCovariance,
    HeldOutResiduals,
    held_out_covariance,
    held_out_residuals,
)
from twin.artefact.observations import Observations
from twin.identification import Estimate, identify, residual_covariance
from twin.machine.forward_model import exact_deviation

MACHINES, REPEATS, ORDER, MAX_CHI2 = 30, 7, 6, 2.0
STATIONS_MM = ((700.0, 1000.0, 750.0), (1567.0, 1000.0, 750.0), (2433.0, 1000.0, 750.0), (3300.0, 1000.0, 750.0))
HELD_OUT = [
    (STATIONS_MM[0], [(-120.0, -60.0), (-30.0, -60.0), (-60.0, 60.0)]),
    (STATIONS_MM[3], [(30.0, -60.0)]),
]
"""Stations and orientations in degrees that the agent holds out for S3 in the case study."""
CONDITIONS = MeasuringConditions(clamping_roll_rad=0.4)
STEPS = (1.0, 0.35)
"""Shares of the estimated errors that the former table leaves."""
DEVIATES = np.random.default_rng(7).normal(size=200)


@dataclass(frozen=True)
class Draw:
    """One proof: the probability of acceptance foreseen before the measurement with the former table, whether the table
    was written after it, and whether the proof accepts it if it works, has no effect, is applied with the wrong sign by
    the controller, or was computed with the wrong sign."""

    step: float
    foreseen: float
    written: bool
    works: bool
    idle: bool
    wrong_sign: tuple[bool, bool]


@dataclass(frozen=True, eq=False)
class HeldOutCase:
    """Held-out balls of one machine, measured with the former and with the new table, and the estimate of its errors
    with their covariance at these balls."""

    estimate: Estimate
    artefact: Artefact
    field: Array
    former: Observations
    later: Observations

    @cached_property
    def corrections(self) -> dict[int, Array]:
        """Corrections (n, 3) in mm of all estimated errors at the balls of both measurements."""
        model, parameters = self.estimate.model, self.estimate.parameters
        return {
            id(part): -np.asarray(exact_deviation(model, part.axis_positions, TOOL, parameters))
            for part in (self.former, self.later)
        }

    def residuals(self, part: Observations, share: float) -> HeldOutResiduals:
        """Residuals at the displayed positions, if `share` of the estimated errors is corrected."""
        displayed = part.axis_positions - share * self.corrections[id(part)]
        return held_out_residuals(part, displayed + TOOL, self.artefact)

    @cached_property
    def covariance(self) -> HeldOutCovariance:
        placed_mm = self.residuals(self.later, 1.0).placed_mm
        return held_out_covariance(self.later, placed_mm, self.artefact, self.field)

    def effect_test(self, more: float) -> EffectTest:
        """Test of a table that corrects the share `more` of the estimated errors in addition to the former one."""
        covariance = self.covariance
        change = covariance.projected(-more * self.corrections[id(self.former)])
        return EffectTest.of(change, covariance, covariance.touches, 1.0, MAX_CHI2)

    def draw(self, step: float) -> Draw:
        test, before = self.effect_test(step), self.residuals(self.former, 1.0 - step).residuals_mm

        def accepts(test: EffectTest, share: float) -> bool:
            return test.measured(before, self.residuals(self.later, share).residuals_mm).accepted

        worse = 1.0 - 2.0 * step
        return Draw(
            step,
            float(np.mean([test.expected_power(deviate) for deviate in DEVIATES])),
            test.power(before) >= REQUIRED_POWER,
            works=accepts(test, 1.0),
            idle=accepts(test, 1.0 - step),
            wrong_sign=(accepts(test, worse), accepts(self.effect_test(-step), worse)),
        )


@cache
def draws() -> tuple[Draw, ...]:
    found: list[Draw] = []
    family = family_of(ORDER)
    for seed in range(MACHINES):
        rng = np.random.default_rng([seed, 5])
        machine, bar = foreign_machine(rng), tilted_bar(rng)
        seen = measure(machine, bar, S3, rng, stations=STATIONS_MM).seen
        estimate = identify(family.model, seen, bar.artefact, family)
        for _ in range(REPEATS):
            former, later = (measure_at(machine, bar, HELD_OUT, rng, CONDITIONS).seen for _ in range(2))
            former, later = (
                part.select(np.isin(keys(part), keys(other))) for part, other in ((former, later), (later, former))
            )
            field = residual_covariance(estimate, later.axis_positions, TOOL)
            case = HeldOutCase(estimate, bar.artefact, field, former, later)
            found += [case.draw(step) for step in STEPS]
    return tuple(found)


def keys(part: Observations) -> Array:
    return np.asarray(100 * part.position + part.ball)


@pytest.mark.parametrize("step", STEPS)
def test_tables_without_effect_or_with_the_wrong_sign_are_found_out(step: float) -> None:
    found = [one for one in draws() if one.step == step]
    assert len(found) >= 200
    assert not any(sign for one in found for sign in one.wrong_sign)
    assert np.mean([one.written and one.idle for one in found]) <= 0.05 + 0.03  # two standard deviations of 210 draws


@pytest.mark.parametrize("step", STEPS)
def test_tables_that_work_are_accepted_as_often_as_foreseen(step: float) -> None:
    found = [one for one in draws() if one.step == step]
    accepted = np.mean([one.written and one.works for one in found])
    assert accepted == pytest.approx(
        np.mean([one.foreseen for one in found]), abs=0.15
    )  # two standard deviations of 30 machines
    assert np.mean([one.works for one in found if one.written]) >= REQUIRED_POWER
