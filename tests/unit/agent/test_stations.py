"""Mounts and artefacts of the stations: nonsense is refused by its key, and a plan asks for what is really carried."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from touched_ball import TouchedBall

from agent.execution import steps as s
from agent.planning.job import Job
from agent.planning.job_preparation import prepare_job
from agent.planning.stations import park_distance_mm
from agent.probing.station_change import CarriedItem, StationChange, change_station, park_mounts
from agent.settings.load import load_settings
from agent.settings.schema import Settings
from drivers.errors import ConfigurationError
from drivers.roles import OperatorTask
from twin.artefact.position_set import Position

CONFIG = Path(__file__).resolve().parents[3] / "config" / "two-mounts.toml"
BARS = [str(CONFIG.parent / "artefacts" / name) for name in ("ball-bar-1500.toml", "ball-bar-1500-b.toml")]
Change = Callable[[dict[str, Any]], object]


def two_mounts(change: Change = lambda _: None) -> Job:
    document = tomllib.loads(CONFIG.read_text(encoding="utf-8"))
    change(document)
    settings = Settings.model_validate(document).resolved(CONFIG.parent)
    return prepare_job(settings, CONFIG.parent)


def without_artefacts(document: dict[str, Any]) -> None:
    del document["stations"]["artefacts"]
    document["stations"]["standing_at"] = 1


def test_jobs_of_the_same_machine_share_what_was_found_out_about_its_layout() -> None:
    def higher(document: dict[str, Any]) -> None:
        document["stations"]["places_mm"][0][2] += 1.0

    assert two_mounts().layout is two_mounts().layout
    assert two_mounts(higher).layout is not two_mounts().layout


@pytest.mark.parametrize(
    ("change", "key", "said"),
    [
        (lambda d: d["roles"]["mount"].pop("2"), "roles.mount.2", "station 2 has no mount"),
        (lambda d: d["roles"]["mount"].update({"3": "mount-2"}), "roles.mount.3", "no station 3"),
        (lambda d: d["roles"]["mount"].update({"2": "mount-1"}), "roles.mount.2", "is already the mount of station 1"),
        (lambda d: d["roles"].update(mount="mount-1"), "stations.artefacts", "need a mount at every station"),
        (lambda d: d["stations"]["artefacts"].pop(), "stations.artefacts", "1 artefacts for 2 stations"),
        (lambda d: d["stations"].update(artefacts=[BARS[0]] * 2), "stations.artefacts", "same artefact"),
        (lambda d: d.update(artefact=BARS[1]), "artefact", "that of station 1"),
    ],
)
def test_what_cannot_be_meant_is_refused_by_its_key(change: Change, key: str, said: str) -> None:
    with pytest.raises(ConfigurationError, match=said) as caught:
        two_mounts(change)
    assert caught.value.where["key"] == key


def test_artefacts_of_two_kinds_are_refused_by_their_key(tmp_path: Path) -> None:
    short = tmp_path / "short.toml"
    lines = Path(BARS[1]).read_text(encoding="utf-8").splitlines()
    last_ball = lines.index("]") - 1
    short.write_text("\n".join(lines[:last_ball] + lines[last_ball + 1 :]), encoding="utf-8")
    with pytest.raises(ConfigurationError, match="10 balls") as caught:
        two_mounts(lambda d: d["stations"].update(artefacts=[BARS[0], str(short)]))
    assert caught.value.where["key"] == "stations.artefacts"


@pytest.mark.parametrize(
    ("old", "new", "refused"),
    [("node_id = 3", "node_id = 1", "azimuth"), ("node_id = 4", "node_id = 1", "elevation")],
)
def test_a_node_id_twice_on_one_bus_is_refused_before_anything_opens(
    tmp_path: Path, old: str, new: str, refused: str
) -> None:
    wrong = tmp_path / "wrong.toml"
    wrong.write_text(CONFIG.read_text(encoding="utf-8").replace(old, new), encoding="utf-8")
    with pytest.raises(
        ConfigurationError, match=r"CANopen node 1 on socketcand:can0.* is already used by device 'mount-1'"
    ) as it:
        load_settings(wrong)
    assert it.value.where["key"] == f"devices.mount-2.options.{refused}.node_id"


def test_the_same_node_ids_on_another_bus_are_good(tmp_path: Path) -> None:
    text = (
        CONFIG.read_text(encoding="utf-8").replace("node_id = 3", "node_id = 1").replace("node_id = 4", "node_id = 2")
    )
    first, second = text.split("[devices.mount-2.options]")
    good = tmp_path / "good.toml"
    good.write_text(first + "[devices.mount-2.options]" + second.replace('"can0"', '"can1"', 1), encoding="utf-8")
    assert sorted(load_settings(good).devices) == ["cnc", "mount-1", "mount-2", "operator"]


def test_how_one_gets_from_station_to_station() -> None:
    own = two_mounts().rules.change
    assert (own.carried, own.own_mounts, own.parked_deg) == (CarriedItem.NOTHING, (1, 2), (0.0, 90.0))
    assert two_mounts(without_artefacts).rules.change.carried is CarriedItem.ARTEFACT
    case_study = CONFIG.parent / "case-study.toml"
    assert prepare_job(load_settings(case_study), CONFIG.parent).rules.change == StationChange()


def test_balls_of_the_second_station_are_counted_on() -> None:
    job = two_mounts()
    assert job.artefact.count == 22
    assert [job.layout.first_ball(station) for station in (1, 2)] == [0, 11]
    nominal = [job.layout.nominal(Position(station, 0.0, 0.0)) for station in (1, 2)]
    assert nominal[0].shape == nominal[1].shape == (11, 3)
    moved = nominal[1] - nominal[0] - [2200.0, 0.0, 0.0]
    assert moved == pytest.approx(job.artefact.balls[11:] - job.artefact.balls[:11])


class Locations:
    def at_retreat_plane(self, position: np.ndarray) -> np.ndarray:
        return np.array([position[0], 0.0, position[2]])

    def park_location(self, position: np.ndarray, station: int) -> np.ndarray:
        return np.array([1000.0 * station, 0.0, position[2]])


def steps_of(change: StationChange, leaving: int | None) -> list[s.Step]:
    player = TouchedBall(np.zeros(3), 1.0, lambda *_: 0.0)
    player.run(change_station("m", change, Locations(), np.array([5.0, 6.0, 7.0]), leaving=leaving, to=2, index=4))
    return player.steps


def test_one_mount_is_carried_and_nothing_turns() -> None:
    asked, permitted, read = steps_of(StationChange(), 1)
    assert isinstance(asked, s.AskOperator)
    assert (asked.request.task, asked.request.station) == (OperatorTask.MOVE_ARTEFACT, 2)
    assert "its mount" in asked.request.text
    assert isinstance(permitted, s.CheckPermissions)
    assert isinstance(read, s.ReadPosition)


class Jogging(TouchedBall):
    """Machine whose axes the person who is asked jogs beside the artefact."""

    def to(self, step: s.Step) -> Any:
        if isinstance(step, s.AskOperator):
            self.at = np.array([2600.0, 650.0, 730.0])
        return super().to(step)


def test_the_next_motion_begins_where_the_person_who_carried_the_mount_has_left_the_axes() -> None:
    """From there, a motion to the retreat plane at the place before would cross the artefact."""
    change, player = StationChange(), Jogging(np.zeros(3), 1.0, lambda *_: 0.0)
    here = player.run(change_station("m", change, Locations(), np.zeros(3), leaving=1, to=2, index=4))
    assert here.tolist() == [2600.0, 650.0, 730.0]


def test_an_artefact_is_taken_off_a_mount_that_was_parked_with_the_probe_away() -> None:
    retreat, beside, turn, asked, *_ = steps_of(StationChange(CarriedItem.ARTEFACT, (1, 2)), 1)
    assert isinstance(retreat, s.MoveTo)
    assert retreat.target_mm == (5.0, 0.0, 7.0)
    assert isinstance(beside, s.MoveTo)
    assert beside.target_mm == (1000.0, 0.0, 7.0)
    assert isinstance(turn, s.OrientTo)
    assert (turn.station, turn.azimuth_deg, turn.elevation_deg) == (1, 0.0, 90.0)
    assert isinstance(asked, s.AskOperator)
    assert "on the mount at station 2" in asked.request.text


def test_where_every_station_has_its_own_nobody_is_asked() -> None:
    own = StationChange(CarriedItem.NOTHING, (1, 2))
    assert [type(step) for step in steps_of(own, 1)] == [s.MoveTo, s.MoveTo, s.OrientTo]
    assert steps_of(own, None) == []


def test_every_mount_is_parked_before_a_run_in_its_own_station() -> None:
    player = TouchedBall(np.zeros(3), 1.0, lambda *_: 0.0)
    change = StationChange(CarriedItem.NOTHING, (1, 2, 3))
    here = player.run(park_mounts("probe", "mounts", change, Locations(), np.array([5.0, 6.0, 7.0]), change.own_mounts))
    assert here.tolist() == [3000.0, 0.0, 7.0]
    assert [step.station for step in player.steps if isinstance(step, s.OrientTo)] == [1, 2, 3]
    keys = [step.key for step in player.steps]
    assert len(set(keys)) == len(keys)


def test_the_probe_waits_within_the_travel_of_any_machine() -> None:
    assert park_distance_mm(None, 700.0, (0.0, 4000.0)) == 1000.0
    assert park_distance_mm(None, 300.0, (0.0, 800.0)) == 500.0
    assert park_distance_mm(None, 0.1, (-400.2, 0.3)) == 400.0
    assert park_distance_mm(250.0, 300.0, (0.0, 800.0)) == 250.0
