"""Steps that a verification is said to find, on foreign machines: found as often as stated, with few false alarms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
from long_form import size
from scipy.stats import binom

from campaigns.foreign.artefact import S3, STATIONS_MM, measure, tilted_bar
from campaigns.foreign.machine import foreign_machine
from campaigns.foreign.nights import FAMILY, drift
from twin.identification import identify
from twin.monitoring.step_detection import Innovation, innovation
from twin.monitoring.step_power import FALSE_ALARM, POWER, StepPower

MACHINES = size(check=24, long=192)
"""With 24 machines, steps of one error that are found in 60 % instead of 95 % of all cases are noticed with 81 % (with
48: 98 %), false alarms of 20 % instead of 1 % with 89 % (with 48: 99 %). `make long-forms` takes 192.
"""
ERRORS = ("A0Z", "B0Z", "C0Y", "EAX", "ECZ")
ORIENTATIONS = (S3[0], S3[2], S3[4], S3[5])
ON_RICHER_MACHINES = 0.9
"""Power instead of 95 % on machines whose errors the model cannot follow in full, which the closed form leaves out."""

UNLIKELY = 0.002
"""Probability with which a number of findings is outside the binomial limits by chance, on each side."""


@dataclass(frozen=True)
class Verified:
    """Verification of one machine: whether it raised an alarm without a step, and for each error whether the step that
    is said to be found with 95 % was found, and whether a quarter of that step was."""

    alarm: bool
    found: dict[str, bool]
    found_quarter: dict[str, bool]


@cache
def verified() -> Sequence[Verified]:
    return [_verified(seed) for seed in range(MACHINES)]


def _verified(seed: int) -> Verified:
    rng = np.random.default_rng([seed, 5])
    machine, bar = foreign_machine(rng), tilted_bar(rng)
    calibrated = identify(FAMILY.model, measure(machine, bar, S3, rng).seen, bar.artefact, FAMILY).carried_over()
    stations = [STATIONS_MM[seed % len(STATIONS_MM)]]

    def checked(error: str = "", size: float = 0.0) -> Innovation:
        changed = drift(error, 1e-6 * size)(machine, 1, rng) if error else machine
        seen = measure(changed, bar, ORIENTATIONS, rng, stations=stations).seen
        return innovation(FAMILY, seen, bar.artefact, calibrated)

    unchanged = checked()
    power = StepPower(unchanged.unknowns, unchanged.information)
    limit = power.evidence_for(FALSE_ALARM)

    def is_found(error: str, share: float) -> bool:
        size = power.smallest(error, limit).size
        assert size is not None
        assert size < 50.0
        evidence = {one.error: one.evidence for one in checked(error, share * size).suspects()}
        return evidence[error] >= limit

    return Verified(
        alarm=max(one.evidence for one in unchanged.suspects()) >= limit,
        found={error: is_found(error, 1.0) for error in ERRORS},
        found_quarter={error: is_found(error, 0.25) for error in ERRORS},
    )


@pytest.mark.parametrize("error", ERRORS)
def test_the_stated_step_is_found_about_as_often_as_stated(error: str) -> None:
    found = sum(one.found[error] for one in verified())
    assert found >= binom.ppf(UNLIKELY, MACHINES, ON_RICHER_MACHINES)


def test_all_steps_together_are_found_as_often_as_stated() -> None:
    """Verifications of one machine share its estimate, so the machines are counted and not the steps."""
    shares = np.array([np.mean([one.found[error] for error in ERRORS]) for one in verified()])
    assert shares.mean() == pytest.approx(POWER, abs=3.0 * shares.std() / np.sqrt(MACHINES) + 0.02)


@pytest.mark.parametrize("error", ERRORS)
def test_a_quarter_of_the_step_is_rarely_found(error: str) -> None:
    found = sum(one.found_quarter[error] for one in verified())
    assert found <= binom.ppf(1.0 - UNLIKELY, MACHINES, 0.1)


def test_a_machine_that_did_not_change_raises_no_more_alarms_than_stated() -> None:
    alarms = sum(one.alarm for one in verified())
    assert alarms <= binom.ppf(1.0 - UNLIKELY, MACHINES, FALSE_ALARM)
