"""The sphere prefilter agrees with the exact search."""

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

from twin.collision.bodies import Body
from twin.collision.collision import Scene
from twin.collision.geometry import Capsule, Point, sphere
from twin.collision.sphere_prefilter import SceneSpheres, SpherePrefilter

TIP = Body("tip", sphere((0.0, 0.0, 0.0), 3.0))
coordinate = st.floats(-60.0, 60.0)
points = st.tuples(coordinate, coordinate, coordinate)
balls = st.lists(st.tuples(points, st.floats(0.5, 20.0)), min_size=1, max_size=4)


@given(balls, st.lists(st.tuples(points, points), min_size=1, max_size=5), st.floats(0.0, 5.0), st.floats(0.0, 5.0))
@example([((0.0, 0.0, 8.0), 4.5)], [((0.0, 0.0, 0.0), (0.0, 0.0, -50.0)), ((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))], 2.0, 2.0)
@settings(max_examples=300, deadline=None)
def test_the_exact_search_says_the_same_but_for_its_tolerance(
    around: list[tuple[Point, float]], moves: list[tuple[Point, Point]], clearance_mm: float, closer_mm: float
) -> None:
    bodies = [Body(f"ball {number}", sphere(centre, radius)) for number, (centre, radius) in enumerate(around)]
    scene = Scene([TIP], bodies)
    reduced_mm = {("tip", "ball 0"): closer_mm, ("stem", "ball 1"): 0.0}
    apart = SpherePrefilter(SceneSpheres.of(scene), clearance_mm, reduced_mm)
    less = {pair: apart_mm - 1e-3 for pair, apart_mm in reduced_mm.items()}
    for start, end in moves:
        if apart.certainly_hits(start, end):
            assert not scene.is_free(start, end, clearance_mm, reduced_mm)
        elif all(abs(np.subtract(start, centre) @ np.subtract(end, start)) > 1e-3 for centre, _ in around):
            assert scene.is_free(start, end, clearance_mm - 1e-3, less)


def test_what_is_no_sphere_is_left_to_the_exact_search() -> None:
    bar = Body("bar", Capsule((10.0, 0.0, -50.0), (10.0, 0.0, 50.0), 5.0))
    for scene in (Scene([TIP], [bar]), Scene([Body("stem", bar.shape)], [TIP])):
        apart = SpherePrefilter(SceneSpheres.of(scene), 1.0, {})
        assert not apart.certainly_hits((0.0, 0.0, 0.0), (20.0, 0.0, 0.0))
