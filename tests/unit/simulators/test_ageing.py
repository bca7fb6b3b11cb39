"""Ageing of a machine: effect of each cause on its field, and reproducible nights."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.errors import ConfigurationError
from simulators.scenario import AgeingSettings, read_scenario
from simulators.world.ageing import scenario_of_night
from simulators.world.world import World, true_machine

SCENARIO = read_scenario(Path(__file__).resolve().parents[3] / "config" / "simulators" / "case-study.toml")
CORNERS = np.array([[0.0, 0.0, 0.0], [4000.0, 0.0, 0.0], [0.0, 1300.0, 0.0], [0.0, 0.0, 1500.0]])


def deviation(night: int, **ageing: object) -> np.ndarray:
    """Return the deviation (4, 3) in mm at the corners."""
    settings = SCENARIO.settings.model_copy(update={"ageing": AgeingSettings(night=night, **ageing)})
    return true_machine(replace(SCENARIO, settings=settings)).deviation(CORNERS)


def test_a_season_stretches_the_axes() -> None:
    """A quarter of a period gives the full amplitude: from end to end, amplitude times length."""
    change = deviation(20, seasonal_um_per_m=(5.0, 0.0, -3.0), season_nights=80.0) - deviation(0)
    assert change[1, 0] - change[0, 0] == pytest.approx(5e-6 * 4000.0, abs=1e-6)
    assert change[3, 2] - change[0, 2] == pytest.approx(-3e-6 * 1500.0, abs=1e-6)
    assert change[2, 1] - change[0, 1] == pytest.approx(0.0, abs=1e-6)


def test_a_phase_leaves_the_first_night_as_it_is() -> None:
    shifted = deviation(0, seasonal_um_per_m=(5.0, 5.0, 5.0), phases_deg=(90.0, 45.0, 10.0))
    assert shifted == pytest.approx(deviation(0), abs=1e-12)
    later = deviation(9, seasonal_um_per_m=(5.0, 0.0, 0.0), phases_deg=(90.0, 0.0, 0.0), season_nights=36.0)
    wanted = 5e-6 * 4000.0 * (math.cos(math.pi / 2.0) - 1.0)
    change = later - deviation(0)
    assert change[1, 0] - change[0, 0] == pytest.approx(wanted, abs=1e-6)


def test_a_collision_turns_z_at_its_night_and_not_before() -> None:
    """B0Z rotates the Z travel about Y: d = (B0Z z, 0, 0)."""
    collision = {"collision_night": 17, "collision": {"B0Z": 12.0}}
    assert deviation(16, **collision) == pytest.approx(deviation(16), abs=1e-12)
    for night in (17, 25):
        change = deviation(night, **collision) - deviation(night)
        assert change[3] - change[0] == pytest.approx([12e-6 * 1500.0, 0.0, 0.0], abs=1e-6)


def error_at(minute: float, **ageing: object) -> tuple[float, float]:
    """Return the true volumetric error in µm at that minute of the machine time of the night."""
    settings = SCENARIO.settings.model_copy(update={"ageing": AgeingSettings(**ageing)})
    world = World(replace(SCENARIO, settings=settings))
    world.advance_to(60.0 * minute)
    return world.truth.true_volumetric_error()


@pytest.mark.parametrize(
    ("night", "minute", "struck"), [(16, 60.0, False), (17, 11.9, False), (17, 12.1, True), (18, 1.0, True)]
)
def test_a_collision_in_mid_run_happens_at_its_minute_of_its_night(night: int, minute: float, struck: bool) -> None:
    collision = {"collision_night": 17, "collision": {"B0Z": 60.0}}
    found = error_at(minute, night=night, collision_minute=12.0, **collision)
    whole, struck_before = (
        error_at(minute, night=night),
        error_at(minute, night=night, **{**collision, "collision_night": 1}),
    )
    assert abs(struck_before[0] - whole[0]) > 1.0
    assert found == pytest.approx(struck_before if struck else whole, abs=1e-9)


def test_a_minute_needs_the_night_of_its_collision() -> None:
    with pytest.raises(ValueError, match="collision_minute needs collision_night"):
        AgeingSettings(night=1, collision_minute=12.0, collision={"B0Z": 60.0})


def test_a_walk_has_the_rms_that_is_asked_for_and_goes_on() -> None:
    pairs = [(night, seed) for night in (1, 2) for seed in range(9)]
    steps = [deviation(n, walk_um=1.0, seed=s) - deviation(n - 1, walk_um=1.0, seed=s) for n, s in pairs]
    lengths = np.sqrt([np.mean(np.sum(step**2, axis=1)) for step in steps])
    assert 0.5e-3 < lengths.mean() < 8e-3
    assert deviation(2, walk_um=1.0) == pytest.approx(deviation(2, walk_um=1.0), abs=0.0)
    assert np.abs(deviation(2, walk_um=1.0) - deviation(1, walk_um=1.0)).max() > 1e-5


def test_another_night_is_the_same_machine_and_bar_with_other_noise() -> None:
    one, other = World(scenario_of_night(SCENARIO, 0)), World(scenario_of_night(SCENARIO, 3))
    assert other.truth.machine.deviation(CORNERS) == pytest.approx(one.truth.machine.deviation(CORNERS), abs=0.0)
    assert other.workpiece.artefact.balls == pytest.approx(one.workpiece.artefact.balls, abs=0.0)
    assert not np.allclose(one.workpiece.location_mm, other.workpiece.location_mm, atol=1e-4)


def test_an_error_that_no_machine_has_is_refused_by_name() -> None:
    with pytest.raises(ConfigurationError, match=r"no error 'EXQ'.*ageing\.collision"):
        deviation(5, collision_night=2, collision={"EXQ": 1.0})
