"""Machine minutes with rounded corners (`benchmarks.blending`), compared with exact stops, with closed forms, with a
motion that is integrated step by step, and with the page that states them."""

from __future__ import annotations

import math
import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from agent.planning.case_file import load_case, shipped_case
from agent.planning.cycle_time import without_optimisation
from agent.planning.run_minutes import MEASURING, run_minutes
from agent.runs.kinds.calibrate import calibration_of
from benchmarks.blending import BlendedDynamics, CornerLaw, RunOfWays, for_blending, walk_ways
from twin.arrays import Array
from twin.collision.motion_law import travel_times

PAGE = Path(__file__).parents[3] / "docs" / "explanation" / "where-the-minutes-go.md"
RAPID, ACCELERATION = (300.0, 200.0, 250.0), (500.0, 400.0, 600.0)
ALIKE = (500.0, 500.0, 500.0)
FAR_MM = 2000.0

coordinate = st.integers(-20_000, 20_000).map(lambda hundredths: hundredths / 100.0)
stop = st.tuples(coordinate, coordinate, coordinate)
way = st.lists(stop, min_size=2, max_size=5)


def seconds(stops: list[tuple[float, float, float]], tolerance_mm: float, law: CornerLaw) -> float:
    return float(BlendedDynamics(RAPID, ACCELERATION, 0.0, tolerance_mm, law).moving_seconds(np.array([stops]))[0])


@given(stops=way)
@pytest.mark.parametrize("law", CornerLaw)
def test_without_tolerance_every_corner_is_a_stop(law: CornerLaw, stops: list[tuple[float, float, float]]) -> None:
    points = np.array(stops)
    moves = np.diff(points, axis=0)
    assume(bool((np.linalg.norm(np.cross(moves[:-1], moves[1:]), axis=1) > 1.0).all()))
    expected = travel_times(points[:-1], points[1:], RAPID, ACCELERATION).sum()
    assert seconds(stops, 0.0, law) == pytest.approx(expected, abs=1e-5)


@given(stops=way, tolerance_mm=st.floats(0.01, 50.0))
@pytest.mark.parametrize("law", CornerLaw)
def test_a_rounded_way_is_never_slower_than_exact_stops_and_the_same_backwards(
    law: CornerLaw, stops: list[tuple[float, float, float]], tolerance_mm: float
) -> None:
    rounded = seconds(stops, tolerance_mm, law)
    assert rounded <= seconds(stops, 0.0, law) + 1e-9
    assert rounded == pytest.approx(seconds(stops[::-1], tolerance_mm, law), abs=1e-6)


@given(stops=way, tolerance_mm=st.floats(0.0, 5.0), times=st.integers(1, 3))
def test_a_repeated_stop_changes_nothing(
    stops: list[tuple[float, float, float]], tolerance_mm: float, times: int
) -> None:
    repeated = [*stops[:-1], *[stops[-2]] * times, stops[-1]]
    assert seconds(repeated, tolerance_mm, CornerLaw.OVERLAP) == pytest.approx(
        seconds(stops, tolerance_mm, CornerLaw.OVERLAP), abs=1e-9
    )


def saved_at_one_corner(law: CornerLaw, tolerance_mm: float, feed_mm_per_s: float, degrees: float) -> float:
    """Return the time in s that the rounding of one corner saves between two long moves in the plane of X and Y."""
    turn = math.radians(degrees)
    stops = np.array([[(-FAR_MM, 0.0, 0.0), (0.0, 0.0, 0.0), (FAR_MM * math.cos(turn), FAR_MM * math.sin(turn), 0.0)]])
    feeds = np.full(2, feed_mm_per_s)
    times = [BlendedDynamics((1e4,) * 3, ALIKE, 0.0, t, law).way_seconds(stops, feeds)[0] for t in (0.0, tolerance_mm)]
    return float(times[0] - times[1])


def farthest_from_corner(velocity: Array, change: Array, duration_s: float, begin: Array) -> float:
    """Integrate a motion from `begin` (2,) that starts with `velocity` (2,) and changes it by `change` (2,) at a
    constant rate; return the smallest distance from the corner, which is the origin."""
    steps = 20_000
    at, nearest = begin.copy(), float(np.linalg.norm(begin))
    for step in range(steps):
        at = at + (velocity + change * (step + 0.5) / steps) * duration_s / steps
        nearest = min(nearest, float(np.linalg.norm(at)))
    return nearest


@pytest.mark.parametrize("tolerance_mm", [0.5, 2.0, 5.0])
def test_overlapping_axes_keep_their_acceleration_and_the_tolerance(tolerance_mm: float) -> None:
    # Exact stop: v/a to brake and v/a to accelerate. Overlapped: both in the same v/a. Saved: v/a.
    a = ALIKE[0]
    saved_s = saved_at_one_corner(CornerLaw.OVERLAP, tolerance_mm, 1e4, 90.0)
    v = saved_s * a
    begin = np.array([-0.5 * v * v / a, 0.0])
    nearest = farthest_from_corner(np.array([v, 0.0]), np.array([-v, v]), v / a, begin)
    assert nearest == pytest.approx(tolerance_mm, rel=1e-6)


@pytest.mark.parametrize("tolerance_mm", [0.5, 2.0, 5.0])
@pytest.mark.parametrize("degrees", [30.0, 90.0, 140.0])
def test_an_arc_at_its_speed_keeps_the_centripetal_acceleration_and_the_tolerance(
    tolerance_mm: float, degrees: float
) -> None:
    # The junction deviation of GRBL: v² = a d sin(θ/2) / (1 - sin(θ/2)), with the angle θ between the two moves.
    a, turn = ALIKE[0], math.radians(degrees)
    s = math.sin(0.5 * (math.pi - turn))
    v = math.sqrt(a * tolerance_mm * s / (1.0 - s))
    radius = v * v / a
    replaced = radius * math.tan(0.5 * turn)
    # At the feed v, a ramp of v²/2a costs v/2a more than running on at v, on each of both moves. Along the second,
    # between the axes, the acceleration is larger. The arc runs on at v.
    along = a / max(abs(math.cos(turn)), abs(math.sin(turn)))
    expected = 2.0 * replaced / v + 0.5 * v / a + 0.5 * v / along - turn * radius / v
    assert saved_at_one_corner(CornerLaw.ARC, tolerance_mm, v, degrees) == pytest.approx(expected, rel=1e-6)


def test_two_corners_far_apart_save_twice_as_much_and_close_together_less() -> None:
    def saved(apart_mm: float) -> float:
        stops = np.array([[(0, 0, 0), (FAR_MM, 0, 0), (FAR_MM, apart_mm, 0), (2 * FAR_MM, apart_mm, 0)]], dtype=float)
        exact, rounded = (BlendedDynamics((200.0,) * 3, ALIKE, 0.0, t).moving_seconds(stops)[0] for t in (0.0, 2.0))
        return float(exact - rounded)

    one = saved_at_one_corner(CornerLaw.OVERLAP, 2.0, 200.0, 90.0)
    assert saved(FAR_MM) == pytest.approx(2.0 * one, rel=1e-9)
    assert 0.0 < saved(4.0) < 1.9 * one


@cache
def quick() -> RunOfWays:
    return walk_ways(load_case(shipped_case("quick").settings))


def test_exact_stops_give_the_minutes_of_the_planner() -> None:
    planned = run_minutes(quick().job, calibration_of)
    assert quick().minutes(0.0, CornerLaw.ARC, measuring=True) == pytest.approx(planned.by_phase[MEASURING], abs=1e-9)
    assert quick().minutes(0.0, CornerLaw.ARC, measuring=False) == pytest.approx(planned.total, abs=1e-9)


def test_plain_paths_leave_no_choice() -> None:
    plain = without_optimisation(load_case(shipped_case("quick").settings))
    assert for_blending(plain, 2.0, CornerLaw.ARC) is plain


def test_the_page_states_what_could_be_saved() -> None:
    row = re.search(r"^\| `quick` \| 2 mm \|(.*)\|$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    assert row is not None
    exact, overlap, overlap_best, _, arc, _, arc_proved = (float(cell) for cell in row.group(1).split("|"))
    best = walk_ways(for_blending(quick().job, 2.0, CornerLaw.OVERLAP))
    proved = walk_ways(for_blending(quick().job, 2.0, CornerLaw.ARC, extra_clearance_mm=2.0))
    minutes = quick().minutes(0.0, CornerLaw.ARC, measuring=True)
    saved = [
        minutes - walked.minutes(2.0, law, measuring=True)
        for walked, law in (
            (quick(), CornerLaw.OVERLAP),
            (best, CornerLaw.OVERLAP),
            (quick(), CornerLaw.ARC),
            (proved, CornerLaw.ARC),
        )
    ]
    assert [exact, overlap, overlap_best, arc, arc_proved] == pytest.approx([minutes, *saved], abs=0.0101)
