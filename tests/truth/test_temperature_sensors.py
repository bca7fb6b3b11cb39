"""Sensors that are taken, and what is predicted with them, on machines in halls that share no code with the program."""

from __future__ import annotations

import numpy as np
import pytest

from campaigns.sensors.drifting_machine import Kind, drifting_machine
from campaigns.sensors.hall_climate import hall_climate
from campaigns.sensors.judged_sensors import FIRST, JudgedMachine, explained, judged, summary

MACHINES = 4


def taken(kind: Kind, number: int) -> frozenset[int]:
    machine = drifting_machine(number, kind)
    found = explained(machine, len(machine.days))
    return frozenset(machine.sensors.index(name) for name in found.taken)


@pytest.fixture(scope="module")
def thermal() -> list[JudgedMachine]:
    return [judged("thermal", number) for number in range(FIRST, FIRST + MACHINES)]


def test_temperatures_explain_machines_that_follow_them(thermal: list[JudgedMachine]) -> None:
    found = summary(thermal)
    assert sum(one.taken > 0 for one in thermal) >= MACHINES - 1
    assert found["left_um"][-1] < 0.8 * found["drift_um"][-1]
    assert found["left_out_nights_um"][1] < found["left_out_nights_um"][0]


def test_the_stated_bands_contain_the_change(thermal: list[JudgedMachine]) -> None:
    assert summary(thermal)["coverage_percent"] >= 85.0


def test_a_drift_of_another_cause_is_not_explained() -> None:
    assert [taken("unrelated", number) for number in range(FIRST, FIRST + MACHINES)] == [frozenset()] * MACHINES


def test_sensors_of_another_hall_are_left_out() -> None:
    for number in range(FIRST, FIRST + MACHINES):
        assert not taken("decoys", number) & drifting_machine(number, "decoys").decoys


def test_a_stuck_sensor_is_never_taken() -> None:
    for number in range(FIRST, FIRST + MACHINES):
        assert not taken("stuck", number) & drifting_machine(number, "stuck").stuck


def test_the_bodies_follow_the_air_with_lags_of_their_own() -> None:
    """A slower body varies less; each is within what the air and its own heat reach."""
    for number in range(6):
        bodies = hall_climate(np.random.default_rng(number), 40).bodies
        column, _, bed, air = np.std(bodies - bodies.mean(axis=0), axis=0)
        assert bed < column < air
        assert bodies[:, 0].max() <= bodies[:, 3].max() + 1.0
