"""Distances and sweeps compared with brute-force sampling, which does not use closest points."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.collision.bodies import Body
from twin.collision.collision import Scene
from twin.collision.geometry import Box, Capsule, separation, swept_contact

coordinate = st.floats(-50.0, 50.0).map(lambda value: round(value, 3))
points = st.tuples(coordinate, coordinate, coordinate)
radii = st.floats(0.5, 8.0).map(lambda value: round(value, 3))
spheres = st.builds(lambda centre, radius: Capsule(centre, centre, radius), points, radii)
capsules = st.one_of(st.builds(Capsule, points, points, radii), spheres)


@st.composite
def boxes(draw: st.DrawFn) -> Box:
    p, q = draw(points), draw(points)
    low = tuple(min(a, b) for a, b in zip(p, q, strict=True))
    high = tuple(max(a, b) for a, b in zip(p, q, strict=True))
    return Box(low, high)  # type: ignore[arg-type]


@st.composite
def scenes(draw: st.DrawFn) -> Scene:
    bodies = st.lists(st.builds(Body, st.just("body"), st.one_of(capsules, boxes())), max_size=6)
    return Scene(draw(bodies), draw(bodies))


def along(capsule: Capsule, count: int) -> np.ndarray:
    share = np.linspace(0.0, 1.0, count)[:, None]
    return np.array(capsule.a) * (1.0 - share) + np.array(capsule.b) * share


def sampled_distance(first: Capsule, second: Capsule, count: int = 160) -> float:
    gaps = along(first, count)[:, None] - along(second, count)[None]
    return float(np.linalg.norm(gaps, axis=2).min())


def step(capsule: Capsule, count: int = 160) -> float:
    return float(np.linalg.norm(np.subtract(capsule.a, capsule.b))) / (count - 1)


@given(capsules, capsules)
@settings(max_examples=60, deadline=None)
def test_distance_of_capsules(first: Capsule, second: Capsule) -> None:
    exact = separation(first, second)[0] + first.radius + second.radius
    sampled = sampled_distance(first, second)
    assert exact <= sampled + 1e-9
    assert sampled <= exact + step(first) + step(second) + 1e-9


@given(capsules, boxes())
@settings(max_examples=60, deadline=None)
def test_distance_of_capsule_and_box(capsule: Capsule, box: Box) -> None:
    samples = along(capsule, 400)
    outside = np.linalg.norm(samples - np.clip(samples, box.lower, box.upper), axis=1)
    exact = separation(capsule, box)[0] + capsule.radius
    assert exact <= outside.min() + 1e-9
    assert outside.min() <= exact + step(capsule, 400) + 1e-9
    assert separation(box, capsule)[0] == pytest.approx(exact - capsule.radius)


@given(capsules, st.one_of(capsules, boxes()), points)
@settings(max_examples=80, deadline=None)
def test_a_sweep_meets_what_small_steps_meet(moving: Capsule, obstacle, displacement) -> None:
    if separation(moving, obstacle)[0] <= 1e-3:
        return  # in contact from the start: only the direction counts, tested separately
    fractions = np.linspace(0.0, 1.0, 500)
    way = np.array(displacement)
    gaps = np.array([separation(moving.translated(tuple(f * way)), obstacle)[0] for f in fractions])
    found = swept_contact(moving, obstacle, displacement)
    small = float(np.linalg.norm(way)) / 499
    if found is None:
        assert gaps.min() > -1e-6
    else:
        assert separation(moving.translated(tuple(found * way)), obstacle)[0] == pytest.approx(0.0, abs=2e-5)
        assert gaps[fractions < found].min(initial=np.inf) > -1e-5
        assert gaps.min() <= small + 1e-9


@given(scenes(), points, points, st.sampled_from([0.0, 3.0, 60.0]))
@settings(max_examples=80, deadline=None)
def test_near_are_those_whose_boxes_meet(scene: Scene, start, end, clearance_mm) -> None:
    travel_low, travel_high = np.minimum(start, end) - clearance_mm, np.maximum(start, end) + clearance_mm
    meeting = []
    for i, moving in enumerate(scene.moving):
        low, high = moving.shape.lower + travel_low, moving.shape.upper + travel_high
        for j, standing in enumerate(scene.obstacles):
            if np.all(low <= standing.shape.upper) and np.all(high >= standing.shape.lower):
                meeting.append((i, j))
    assert scene.near_pairs(start, end, clearance_mm) == meeting


def test_a_body_in_contact_may_leave_but_not_press_on() -> None:
    ball, wall = Capsule((0, 0, 0), (0, 0, 0), 1.0), Box((-5.0, 0.9, -5.0), (5.0, 2.0, 5.0))
    assert swept_contact(ball, wall, (0.0, -3.0, 0.0)) is None
    assert swept_contact(ball, wall, (0.0, 3.0, 0.0)) == 0.0
    assert swept_contact(ball, wall, (3.0, 0.0, 0.0)) is None


def test_clearance_makes_the_contact_earlier() -> None:
    ball, wall = Capsule((0, 0, 0), (0, 0, 0), 1.0), Box((-5.0, 11.0, -5.0), (5.0, 12.0, 5.0))
    assert swept_contact(ball, wall, (0.0, 20.0, 0.0)) == pytest.approx(0.5)
    assert swept_contact(ball, wall, (0.0, 20.0, 0.0), 4.0) == pytest.approx(0.3)
    assert swept_contact(ball, wall, (0.0, 9.9, 0.0)) is None
