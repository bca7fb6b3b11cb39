"""An artefact that is placed by hand: settings that contradict it, the request, and the balls that locate it."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.errors import PlacementLost
from agent.execution import steps as s
from agent.execution.engine import Engine
from agent.planning.job import Job
from agent.planning.job_preparation import prepare_job
from agent.probing.hand_placement import (
    PlacementFault,
    PlacementRefusal,
    PlacementTask,
    deviation,
    placement_request,
    search_columns,
)
from agent.settings.schema import Settings
from drivers.errors import ConfigurationError
from drivers.roles import OperatorTask
from twin.artefact.placement_tolerance import PlacementTolerance
from twin.artefact.position_set import Position
from twin.collision.locating_balls import locating_balls
from twin.errors import DataError, FormatError
from twin.formats.toml_reading import validate_document

CONFIG = Path(__file__).resolve().parents[3] / "config" / "hand-placed.toml"
POSITION = Position(2, 30.0, 0.0)
Change = Callable[[dict[str, Any]], object]


def hand_placed(change: Change = lambda _: None) -> Job:
    document = tomllib.loads(CONFIG.read_text(encoding="utf-8"))
    change(document)
    settings = validate_document(document, CONFIG.name, Settings).resolved(CONFIG.parent)
    return prepare_job(settings, CONFIG.parent)


@pytest.fixture(scope="module")
def job() -> Job:
    return hand_placed()


@pytest.mark.parametrize(
    ("change", "key", "said"),
    [
        (lambda d: d["roles"].update(mount="cnc"), "roles.mount", "has no mount"),
        (lambda d: d["stations"].pop("placed_by_hand"), "roles.mount", "no device is the mount"),
        (
            lambda d: d["stations"].update(artefacts=[d["artefact"]] * 4),
            "stations.artefacts",
            "the same at all stations",
        ),
        (lambda d: d["verification"].pop("positions_deg"), "verification.positions_deg", "must be listed"),
        (lambda d: d["mount"].update(table_z_mm=-150.0), "stations.places_mm", "10.0 mm inside the table"),
        (
            lambda d: d["stations"].update(places_mm=[[240.0 + 320.0 * (n % 2), 250.0, -45.0] for n in range(4)]),
            "stations.places_mm",
            "cannot cross above the artefact",
        ),
    ],
)
def test_what_contradicts_it_is_refused_by_its_key(change: Change, key: str, said: str) -> None:
    with pytest.raises(ConfigurationError, match=said) as caught:
        hand_placed(change)
    assert caught.value.where["key"] == key


def test_a_search_that_ends_in_the_holder_of_a_ball_is_refused(tmp_path: Path) -> None:
    # Balls of 20 mm on holders of 6 mm: the tip may move 7 mm on, so v = √(2 · 400 · 7) mm/s = 4490 mm/min.
    slow = tmp_path / "slow.toml"
    text = (CONFIG.parent / "machines" / "mill.toml").read_text(encoding="utf-8")
    slow.write_text(text.replace("acceleration_mm_per_s2 = 2000.0", "acceleration_mm_per_s2 = 400.0"), encoding="utf-8")

    def searched_at(feed: float) -> Job:
        return hand_placed(lambda d: (d.update(machine=str(slow)), d["procedure"].update(guarded_feed_mm_per_min=feed)))

    with pytest.raises(ConfigurationError, match=r"moves 7\.3 mm until Z stands") as caught:
        searched_at(4600.0)
    assert caught.value.where["key"] == "procedure.guarded_feed_mm_per_min"
    assert caught.value.hint == "state less than 4489 mm/min"
    assert searched_at(4488.0).settings.procedure.guarded_feed_mm_per_min == 4488.0


def test_the_parts_of_a_mount_are_refused_by_their_key() -> None:
    with pytest.raises(FormatError, match=r"mount\.shaft_mm: .* has no mount"):
        hand_placed(lambda d: d["mount"].update(shaft_mm=100.0))


def test_settings_that_were_stored_are_read_again(job: Job) -> None:
    assert Settings.model_validate(job.settings.model_dump(mode="json")) == job.settings


def test_nothing_of_a_mount_is_left(job: Job) -> None:
    assert job.settings.mount.shaft_vector_mm == (0.0, 0.0, 0.0)
    at_place = job.layout.location(2) + job.artefact.balls[:, :] * [1.0, 1.0, 1.0]
    nominal = job.layout.nominal(Position(2, 0.0, 0.0)) + job.tool_offset_mm
    assert nominal == pytest.approx(at_place)


def test_the_request_says_where_in_words_and_in_figures(job: Job) -> None:
    assert job.rules.placement is not None
    task = PlacementTask.of("k", POSITION, job.layout, job.rules.retreat, job.rules.probing, job.rules.placement)
    request = placement_request(task)
    assert (request.task, request.station) == (OperatorTask.PLACE_ARTEFACT, 2)
    assert (request.azimuth_deg, request.elevation_deg, request.refused) == (30.0, 0.0, "")
    first = request.balls[0]
    assert first.ball == task.balls.first
    assert first.position_mm == pytest.approx(job.layout.nominal(POSITION)[first.ball], abs=0.05)
    assert "station 2, azimuth 30°, elevation 0°" in request.text
    again = placement_request(task, PlacementRefusal(PlacementFault.TURNED, "it is turned", 4))
    assert (again.refused, again.refused_ball) == ("turned", 4)
    assert again.text.startswith("The last placement was refused: it is turned.")


def test_the_first_ball_is_at_the_top_and_the_second_far_away(job: Job) -> None:
    nominal = job.layout.nominal(POSITION)
    reachable = [int(ball) for ball in np.flatnonzero(job.layout.reachable(POSITION, nominal))]
    chosen = locating_balls(job.layout, POSITION, reachable)
    assert nominal[chosen.first][2] == max(nominal[reachable][:, 2])
    assert math.dist(nominal[chosen.first], nominal[chosen.second]) > 200.0
    assert chosen.third not in (None, chosen.first, chosen.second)


def test_balls_under_a_high_part_of_the_artefact_cannot_locate_it(job: Job) -> None:
    low = [0, 1, 2]  # the corners of the base, 200 mm below the top
    with pytest.raises(DataError, match="only the stylus tip"):
        locating_balls(job.layout, POSITION, low)


@given(
    turn_deg=st.floats(-179.0, 179.0),
    shift=st.tuples(*[st.floats(-50.0, 50.0)] * 3),
    seed=st.integers(0, 1000),
)
def test_a_deviation_is_the_motion_that_was_made(turn_deg: float, shift: tuple[float, ...], seed: int) -> None:
    nominal = np.random.default_rng(seed).uniform(-200.0, 200.0, (5, 3))
    c, s_ = math.cos(math.radians(turn_deg)), math.sin(math.radians(turn_deg))
    middle = nominal.mean(axis=0)
    found = (nominal - middle) @ np.array([[c, -s_, 0.0], [s_, c, 0.0], [0.0, 0.0, 1.0]]).T + middle + shift
    moved_mm, turned_deg = deviation(nominal, found)
    assert moved_mm == pytest.approx(math.hypot(*shift), abs=1e-6)
    assert turned_deg == pytest.approx(abs(turn_deg), abs=1e-4)


@pytest.mark.parametrize("distance_mm", [2.0, 5.0, 10.0, 20.0, 30.0])
def test_the_search_leaves_no_gap_within_the_tolerance(job: Job, distance_mm: float) -> None:
    probing = job.rules.probing
    columns = np.array(list(search_columns(PlacementTolerance(distance_mm, 1.0), probing)))[:, :2]
    angles = np.linspace(0.0, 2.0 * math.pi, 73)
    for radius in np.linspace(0.0, distance_mm, 7):
        for x, y in radius * np.column_stack((np.cos(angles), np.sin(angles))):
            assert np.hypot(*(columns - (x, y)).T).min() < probing.contact_mm


def test_the_engine_raises_a_lost_placement_inside_the_plan() -> None:
    def plan() -> s.Plan[str]:
        try:
            yield s.CheckProbe("first")
        except PlacementLost as lost:
            answer: dict[str, float] = yield s.ReadTemperatures("after")
            return f"{lost.message}, {answer['artefact']:g} °C"
        return "not raised"

    def lose(_: s.Step) -> None:
        raise PlacementLost("it is gone")

    engine = Engine({s.CheckProbe: lose, s.ReadTemperatures: lambda _: {"artefact": 20.0}})
    assert engine.run(plan()) == "it is gone, 20 °C"
