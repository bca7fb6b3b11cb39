"""A mount at every station of the simulated world: all are obstacles, each turns alone, and no artefact moves by
accident.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.clock import VirtualClock
from drivers.errors import CommandRejected, ConfigurationError, MotionFault
from simulators.backend import SimulatedMachineDevice
from simulators.scenario import ScenarioDocument, build_scenario
from simulators.world.world import World

FILE = Path(__file__).resolve().parents[3] / "config" / "simulators" / "two-mounts.toml"
UPRIGHT = [0.0, 90.0]


def document(**changes: Any) -> dict[str, Any]:
    return {**tomllib.loads(FILE.read_text(encoding="utf-8")), "ideal": True, **changes}


def world(**changes: Any) -> World:
    return World(build_scenario(ScenarioDocument.model_validate(document(**changes)), FILE.parent))


def device(of: World) -> SimulatedMachineDevice:
    played = SimulatedMachineDevice(of, VirtualClock())
    played.open()
    return played


def four_at_867_mm(**changes: Any) -> World:
    bar = document()["artefacts"][0]
    places = [[700.0 + 867.0 * n, 1000.0, 750.0] for n in range(4)]
    return world(stations_mm=places, artefacts=[bar] * 4, mounts_deg=[UPRIGHT] * 4, **changes)


def test_both_bars_stand_at_once_each_with_its_own_certificate_error() -> None:
    both = world(ideal=False)
    standing = both.table.snapshot(0.0)
    assert len(standing.balls) == 22
    assert standing.ball_names[11] == "ball 0 at station 2"
    first, second = (piece.artefact.balls for piece in both.table.pieces)
    certified = [artefact.balls for artefact in both.scenario.artefacts]
    assert not np.allclose(first - certified[0], second - certified[1], atol=1e-5)
    places = [piece.location_mm for piece in both.table.pieces]
    assert not np.allclose(places[1] - places[0], [2200.0, 0.0, 0.0], atol=1e-3)


def test_mounts_turn_each_by_itself() -> None:
    both = world()
    second = device(both).mount_at(2)
    turned = second.orient_to(45.0, 0.0)
    assert (turned.azimuth_deg, turned.elevation_deg) == pytest.approx((45.0, 0.0))
    assert both.mount_at(1).angles_deg() == (0.0, 90.0)
    with pytest.raises(CommandRejected, match="no station 3"):
        device(both).mount_at(3)


def test_the_probe_is_watched_against_the_bar_that_is_not_measured() -> None:
    both = world()
    played = device(both)
    played.move_to(np.array([2000.0, 0.0, 750.0]), feed_mm_per_s=None, guarded=False)
    played.move_to(np.array([2000.0, 700.0, 750.0]), feed_mm_per_s=None, guarded=False)
    with pytest.raises(MotionFault, match="at station 2"):
        played.move_to(np.array([3900.0, 700.0, 750.0]), feed_mm_per_s=None, guarded=False)
    assert both.collisions[0].body_b.endswith("at station 2")


def test_a_bar_that_turns_past_an_upright_one_passes_and_two_level_ones_meet() -> None:
    """Mounts 867 mm apart, bars of 1500 mm: one level and one upright are 87 mm apart, two level ones overlap."""
    four = four_at_867_mm()
    played = device(four)
    played.mount_at(2).orient_to(0.0, 0.0)
    assert four.collisions == []
    with pytest.raises(MotionFault, match="collision"):
        played.mount_at(3).orient_to(0.0, 0.0)
    names = {four.collisions[0].body_a[-9:], four.collisions[0].body_b[-9:]}
    assert names == {"station 2", "station 3"}


def test_where_bars_meet_is_where_brute_force_sees_them_meet() -> None:
    """Tips of two bars rise and fall in one plane, sampled every millisecond."""
    four = four_at_867_mm()
    two, three = four.table.pieces[1:3]
    two.mount.begin_turn("elevation", 0.0)
    three.mount.begin_turn("elevation", 0.0)
    crash = four.turn_crash
    assert crash is not None
    for instant in np.arange(0.0, crash.time_s - 0.02, 0.005):
        gap = min(
            float(np.linalg.norm(np.array(a) - np.array(b)))
            for a in two.snapshot(instant).balls
            for b in three.snapshot(instant).balls
        )
        assert gap > 25.0
    ends = [np.array(piece.snapshot(crash.time_s).balls) for piece in (two, three)]
    assert np.linalg.norm(ends[0][:, None] - ends[1][None], axis=2).min() < 160.0  # a pitch and both radii


def test_a_carried_artefact_leaves_its_mount_bare() -> None:
    carried = world(artefacts=[], standing_at=1)
    assert len(carried.table.snapshot(0.0).balls) == 11
    carried.place_artefact(2)
    standing = carried.table.snapshot(0.0)
    assert standing.ball_names[0] == "ball 0 at station 2"
    names = {body.name for body in standing.bodies}
    assert "shaft at station 1" in names
    assert "bar at station 1" not in names
    assert carried.workpiece.station == 2


def test_own_artefacts_are_never_carried() -> None:
    with pytest.raises(CommandRejected, match="none can be moved"):
        world().place_artefact(2)


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"own_mounts": False}, "artefacts"),
        ({"artefacts": ["../artefacts/ball-bar-1500.toml"]}, "artefacts"),
        ({"mounts_deg": [UPRIGHT]}, "mounts_deg"),
    ],
)
def test_scenarios_that_do_not_fit_are_refused_by_key(changes: dict[str, Any], key: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        world(**changes)
    assert caught.value.where["key"] == key
