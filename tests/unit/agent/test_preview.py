"""Contents of a preview, compared with the preflight, plain trigonometry and the embedded numbers."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from itertools import accumulate, groupby

import numpy as np
import pytest

from agent.errors import PlanRefused
from agent.execution.steps import MoveTo, OrientTo
from agent.planning.case_file import CASE_STUDY
from agent.planning.job import Job
from agent.planning.job_preparation import prepare_job
from agent.planning.preview.artefact_placement import bodies_at
from agent.planning.preview.blob import document, embedded
from agent.planning.preview.builder import preview_of
from agent.planning.preview.figure import draw_png
from agent.planning.preview.preview_files import render_page
from agent.planning.preview.refusal import named_in, refusal_of
from agent.planning.preview.scene import Preview
from agent.planning.preview.tip_path import Waypoint, walk_waypoints
from agent.runs.kinds.calibrate import calibration_of, preflight_of
from agent.settings.load import load_settings, with_overrides
from twin.artefact.position_set import Position
from twin.collision.bodies import Body
from twin.collision.geometry import Capsule, sphere


def job(position_set: str = "S1", stations: tuple[int, ...] = (1, 2)) -> Job:
    settings = with_overrides(load_settings(CASE_STUDY), position_set=position_set, stations=list(stations))
    return prepare_job(settings, CASE_STUDY.parent)


@pytest.fixture(scope="module")
def at_two_stations() -> Job:
    return job()


@pytest.fixture(scope="module")
def preview(at_two_stations: Job) -> Preview:
    return preview_of(at_two_stations, calibration_of)


# ------------------------------------------------------------------ what it holds


def test_it_is_the_plan_of_the_preflight(at_two_stations: Job, preview: Preview) -> None:
    preflight = preflight_of(at_two_stations)
    assert preview.minutes == pytest.approx(preflight.machine_minutes, rel=1e-6)
    assert preview.unreachable == preflight.measured.unreachable_balls
    measuring = [visit for visit in preview.visits if visit.phase in ("measure", "verify")]
    touches = sum(point.touch for visit in measuring for point in preview.path[visit.first : visit.end])
    assert touches == preflight.measured.touches + preflight.verified.touches
    walked = measuring
    assert len(walked) == len(preflight.measured.positions) + len(preflight.verified.positions)
    left_out = [visit for visit in preview.visits if visit.note]
    assert len(left_out) == len(preflight.measured.left_out) > 0
    assert all(visit.note.startswith("left out: 0 of its balls") for visit in left_out)


def test_visits_divide_the_path(preview: Preview) -> None:
    walked = [visit for visit in preview.visits if not visit.note]
    assert [visit.first for visit in walked] == [0, *(visit.end for visit in walked[:-1])]
    assert walked[-1].end == len(preview.path)
    assert [phase for phase, _ in groupby(visit.phase for visit in walked)][-2:] == ["measure", "verify"]


def test_balls_stand_where_trigonometry_puts_them(at_two_stations: Job, preview: Preview) -> None:
    """Centre = foot + shaft along the holders + ball turned by elevation about the holders, then by azimuth about Z."""
    mount = at_two_stations.layout.mount
    for placement in preview.placements:
        azimuth, elevation = (
            math.radians(placement.position.azimuth_deg),
            math.radians(placement.position.elevation_deg),
        )
        foot = at_two_stations.settings.stations.places_mm[placement.position.station - 1]
        for ball, (u, v, w) in zip(placement.balls, at_two_stations.artefact.balls.tolist(), strict=True):
            along, up = (
                u * math.cos(elevation) - w * math.sin(elevation),
                u * math.sin(elevation) + w * math.cos(elevation),
            )
            across = v - mount.shaft_mm
            x = foot[0] + along * math.cos(azimuth) - across * math.sin(azimuth)
            y = foot[1] + along * math.sin(azimuth) + across * math.cos(azimuth)
            assert ball.centre_mm == pytest.approx((x, y, foot[2] + up), abs=1e-6)


def test_the_tip_touches_the_balls_of_its_position(at_two_stations: Job, preview: Preview) -> None:
    """Braking after the trip takes v²/2a = 0.025 mm at 5 mm/s and 500 mm/s²."""
    contact = at_two_stations.layout.contact_mm
    for visit in preview.visits:
        for point in preview.path[visit.first : visit.end]:
            if point.touch:
                assert point.ball is not None
                centre = preview.placements[visit.placement].balls[point.ball].centre_mm
                assert math.dist(point.tip_mm, centre) == pytest.approx(contact, abs=0.06)


def test_a_ball_out_of_reach_says_which_axis_or_what_is_in_the_way(at_two_stations: Job, preview: Preview) -> None:
    layout = at_two_stations.layout
    reasons = set()
    for placement in preview.placements:
        for ball in placement.balls:
            axes = np.array(ball.centre_mm) - at_two_stations.tool_offset_mm
            names = [
                name
                for i, name in enumerate("XYZ")
                if axes[i] < layout.lower_mm[i] - 1e-9 or axes[i] > layout.upper_mm[i] + 1e-9
            ]
            if names:
                assert ball.obstruction.startswith("outside the travel: ")
                assert re.findall(r"([XYZ]) ", ball.obstruction) == names
                reasons.add("outside")
            elif not ball.reachable:
                assert re.fullmatch(r"no access: (tip|stem|probe body|ram) too close to .+", ball.obstruction)
                reasons.add("no access")
    assert reasons == {"outside", "no access"}


# ------------------------------------------------------------------ refusals


def refused_at(step: str, message: str = "preflight: collision: ram with bar") -> PlanRefused:
    return PlanRefused(message, hint="the plan must change", step=step)


def test_a_refused_plan_ends_at_its_step(at_two_stations: Job) -> None:
    key = next(w.step.key for w in walk_waypoints(at_two_stations, calibration_of)[300:] if isinstance(w.step, MoveTo))
    preview = preview_of(at_two_stations, calibration_of, refused_at(key))
    refusal = preview.refusal
    assert refusal is not None
    assert refusal.step == key
    assert refusal.bodies == ("ram", "bar")
    assert "the plan must change" in refusal.message
    walked = [visit for visit in preview.visits if not visit.note]
    assert refusal.visit == len(walked) - 1
    assert walked[-1].end == len(preview.path)
    assert {visit.note.split(":")[0] for visit in preview.visits[len(walked) :]} == {"left out", "not reached"}


def test_the_tip_stops_where_the_bodies_meet(at_two_stations: Job) -> None:
    """Straight along Y onto the pole of a ball: centres are ball and tip radius apart, although the move goes on."""
    position = Position(2, 45.0, 0.0)
    centre = at_two_stations.layout.nominal(position)[3] + at_two_stations.tool_offset_mm
    behind = (centre[0], centre[1] - 60.0, centre[2])
    offset = at_two_stations.tool_offset_mm
    through = MoveTo("measure/station-2/az45-el0/ball-04/approach", tuple((centre - offset).tolist()))
    waypoints = [
        Waypoint(OrientTo("orient", 2, 45.0, 0.0), behind, 0.0, position),
        Waypoint(through, tuple(centre.tolist()), 1.0, position),
    ]
    refused = refused_at(through.key, "preflight: probe tripped in a guarded move")
    refusal = refusal_of(at_two_stations, refused, waypoints, 0)
    assert refusal.bodies == ("tip", "ball 3")
    assert centre[1] - refusal.tip_mm[1] == pytest.approx(at_two_stations.layout.contact_mm, abs=1e-4)


def test_a_refusal_without_a_step_shows_as_much_as_can_be_walked(at_two_stations: Job) -> None:
    preview = preview_of(at_two_stations, calibration_of, PlanRefused("preflight: the stylus cannot be qualified"))
    assert preview.refusal is not None
    assert (preview.refusal.step, preview.refusal.bodies) == ("", ())
    assert preview.path


def test_bodies_are_those_that_the_message_names(at_two_stations: Job) -> None:
    moving, around = (
        at_two_stations.layout.probe.bodies(at_two_stations.layout.frame),
        bodies_at(at_two_stations, Position(1, 0.0, 0.0)),
    )
    assert named_in("collision: tip with ball 10", moving, around) == ("tip", "ball 10")
    assert named_in("collision: probe body with post 1", moving, around) == ("probe body", "post 1")
    assert named_in("X 4001.000 mm is outside 0 to 4000 mm", moving, around) == ()
    assert named_in("ram with nothing", [Body("ram", sphere((0, 0, 0), 1.0))], around) == ()


def test_a_refusal_before_the_first_step_still_shows_the_positions(at_two_stations: Job) -> None:
    preview = preview_of(at_two_stations, calibration_of, refused_at("before/active-bank", "no answer"))
    assert (preview.path, preview.minutes) == ((), 0.0)
    assert preview.refusal is not None
    assert preview.refusal.bodies == ()
    assert all(visit.note for visit in preview.visits)
    assert draw_png(preview).startswith(b"\x89PNG")


# ------------------------------------------------------------------ as embedded, and as drawn


def test_the_numbers_come_back_to_a_twentieth_of_a_millimetre(preview: Preview) -> None:
    read = json.loads(embedded(preview))
    steps = np.array(read["path"]["steps"]).reshape(-1, 3)
    assert steps.cumsum(axis=0) / 10 == pytest.approx(np.array([point.tip_mm for point in preview.path]), abs=0.0501)
    seconds = list(accumulate(read["path"]["times"]))
    assert np.array(seconds) / 100 == pytest.approx(np.array([point.ends_s for point in preview.path]), abs=0.00501)
    balls = [ball for ball, count in read["path"]["balls"] for _ in range(count)]
    assert balls == [-1 if point.ball is None else point.ball for point in preview.path]
    for placement, raw in zip(preview.placements, read["placings"], strict=True):
        assert [ball.obstruction for ball in placement.balls] == [ball[3] for ball in raw["balls"]]
        for body, (index, *numbers) in zip(placement.bodies, raw["bodies"], strict=True):
            assert read["names"][index] == body.name
            assert isinstance(body.shape, Capsule)
            expected = (*body.shape.a, *body.shape.b, body.shape.radius)
            assert np.array(numbers) / 10 == pytest.approx(np.array(expected), abs=0.0501)


def test_no_name_can_break_out_of_the_page(preview: Preview) -> None:
    evil = "</script><script>alert(1)</script><!--"
    page = render_page(dataclasses.replace(preview, machine=evil, artefact=evil, position_set=evil))
    assert "alert(1)</script>" not in page
    assert page.count("<script") == page.count("</script") == 2
    data = re.search(r'id="data">(.*?)</script>', page, re.DOTALL)
    assert data is not None
    assert "<" not in data.group(1)
    assert json.loads(data.group(1))["machine"] == evil


def test_the_page_is_one_file_without_network_even_for_the_largest_sets() -> None:
    page = render_page(preview_of(job("S1+S2+S3", (1, 2, 3, 4)), calibration_of))
    assert len(page.encode()) < 2_000_000
    assert re.findall(r"(?:src|href)\s*=|url\(|@import|https?://|fetch\(|XMLHttpRequest|import\(", page) == []
    assert "default-src 'none'" in page
    assert "prefers-color-scheme: dark" in page


def test_the_picture_shows_a_refusal(at_two_stations: Job, preview: Preview) -> None:
    refused = preview_of(
        at_two_stations, calibration_of, refused_at(walk_waypoints(at_two_stations, calibration_of)[40].step.key)
    )
    passed, shown = draw_png(preview), draw_png(refused)
    for png in (passed, shown):
        width, height = np.frombuffer(png[16:24], dtype=">u4")
        assert (width, height) == (1800, 1350)
    assert passed != shown


def test_the_document_counts(preview: Preview) -> None:
    said = document(preview)
    assert (
        said["balls"] == sum(len(placement.balls) for placement in preview.placements) == 11 * len(preview.placements)
    )
    assert said["unreachable"] == sum(bool(b.obstruction) for placement in preview.placements for b in placement.balls)
    assert said["refusal"] is None
