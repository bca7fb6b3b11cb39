"""Motion laws against hand calculation."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.collision.motion_law import MotionLaw, Phase, straight_path, trapezoid, travel_time_s


def test_a_long_move_ramps_cruises_and_ramps() -> None:
    # 1000 mm at 100 mm/s with 50 mm/s²: ramps of 2 s and 100 mm each, 800 mm in 8 s; 12 s in all.
    law = trapezoid(5.0, 1000.0, 100.0, 50.0)
    assert law.end_s - 5.0 == pytest.approx(12.0)
    assert [law.distance_at(5.0 + t) for t in (0, 1, 2, 6, 10, 11, 12, 99)] == pytest.approx(
        [0.0, 25.0, 100.0, 500.0, 900.0, 975.0, 1000.0, 1000.0]
    )
    assert law.speed_at(8.0) == pytest.approx(100.0)
    assert law.time_at(500.0) == pytest.approx(11.0)


def test_a_short_move_never_reaches_its_speed() -> None:
    # 50 mm with 50 mm/s²: 25 mm up in 1 s, 25 mm down in 1 s.
    law = trapezoid(0.0, 50.0, 100.0, 50.0)
    assert law.end_s == pytest.approx(2.0)
    assert law.speed_at(1.0) == pytest.approx(50.0)


def test_no_way_takes_no_time() -> None:
    assert trapezoid(3.0, 0.0, 100.0, 50.0).end_s == 3.0


def test_braking_takes_v_squared_over_2a() -> None:
    law = trapezoid(0.0, 1000.0, 100.0, 50.0).braked_from(6.0, 50.0)
    assert law.end_s == pytest.approx(8.0)
    assert law.end_distance == pytest.approx(600.0)


def test_a_crash_stops_dead() -> None:
    law = trapezoid(0.0, 1000.0, 100.0, 50.0).truncated_at(1.0)
    assert (law.end_s, law.end_distance) == (1.0, 25.0)


def test_the_slowest_axis_rules_the_path() -> None:
    path = straight_path((0.0, 0.0, 0.0), (30.0, 40.0, 0.0))
    assert path.length == 50.0
    assert path.limit_along((60.0, 40.0, 10.0)) == pytest.approx(50.0)
    assert path.at(25.0) == pytest.approx((15.0, 20.0, 0.0))


@given(st.floats(0.01, 4000.0), st.floats(1.0, 400.0), st.floats(50.0, 2000.0), st.floats(0.0, 1.0))
def test_time_and_distance_are_inverse(length: float, speed: float, acceleration: float, share: float) -> None:
    law = trapezoid(1.0, length, speed, acceleration)
    assert law.distance_at(law.time_at(share * length)) == pytest.approx(share * length, abs=1e-7)
    assert law.end_distance == pytest.approx(length, abs=1e-9)


def test_the_law_is_the_integral_of_its_speed() -> None:
    law: MotionLaw = trapezoid(0.0, 137.0, 40.0, 90.0)
    steps = 20000
    step = law.end_s / steps
    total = sum(law.speed_at((k + 0.5) * step) * step for k in range(steps))
    assert total == pytest.approx(137.0, abs=1e-4)


def test_a_slowing_phase_gives_the_first_passage() -> None:
    assert Phase(0.0, 2.0, 0.0, 10.0, -5.0).time_at(7.5) == pytest.approx(1.0)


@given(st.floats(0.0, 4000.0), st.floats(1.0, 400.0), st.floats(50.0, 2000.0))
def test_a_travel_takes_as_long_as_its_law(length: float, speed: float, acceleration: float) -> None:
    assert travel_time_s(length, speed, acceleration) == pytest.approx(
        trapezoid(7.0, length, speed, acceleration).end_s - 7.0
    )


def test_a_travel_along_one_axis_does_not_ask_the_others() -> None:
    assert straight_path((0.0, 0.0, 0.0), (0.0, -3.0, 0.0)).limit_along((1.0, 60.0, 2.0)) == 60.0
    assert straight_path((1.0, 2.0, 3.0), (1.0, 2.0, 3.0)).limit_along((4.0, 3.0, 5.0)) == 3.0
