import math

import numpy as np
import pytest

from twin.artefact.mount_geometry import MountGeometry
from twin.artefact.position_set import Position, is_reachable, mount_pose, parse_position_set, station_locations
from twin.errors import DataError, TwinError

PLACE = np.array([1000.0, 1000.0, 750.0])
ROOT_HALF = 0.7071067811865476


def test_sets_repeat_station_by_station() -> None:
    s3 = parse_position_set("S3", 4)
    assert len(s3) == 24
    assert s3[:2] == (Position(1, 45.0, 0.0), Position(1, -45.0, 0.0))
    assert [p.station for p in s3] == [1] * 6 + [2] * 6 + [3] * 6 + [4] * 6


def test_combined_sets_hold_each_orientation_once() -> None:
    assert len(parse_position_set("S1+S2+S3", 1)) == 13
    assert parse_position_set("s1+S1", 2) == parse_position_set("S1", 2)


def test_an_unknown_set_is_refused_with_the_known_ones() -> None:
    with pytest.raises(TwinError, match=r"unknown position set 'S9' in 'S1\+S9'.*S1, S2, S3"):
        parse_position_set("S1+S9", 1)


@pytest.mark.parametrize("wrong", [(0, 0.0, 0.0), (1, 200.0, 0.0), (1, 0.0, 91.0), (1, math.nan, 0.0)])
def test_positions_out_of_range_are_refused(wrong: tuple[int, float, float]) -> None:
    with pytest.raises(DataError):
        Position(*wrong)


@pytest.mark.parametrize(
    ("azimuth", "elevation", "axis", "outward"),
    [
        (0, 0, (1, 0, 0), (0, -1, 0)),
        (90, 0, (0, 1, 0), (1, 0, 0)),
        (0, 90, (0, 0, 1), (0, -1, 0)),
        (90, 45, (0, ROOT_HALF, ROOT_HALF), (1, 0, 0)),
        (-45, 0, (ROOT_HALF, -ROOT_HALF, 0), (-ROOT_HALF, -ROOT_HALF, 0)),
    ],
)
def test_the_bar_points_where_the_mount_says(azimuth, elevation, axis, outward) -> None:
    pose = mount_pose(PLACE, MountGeometry(shaft_mm=120.0), math.radians(azimuth), math.radians(elevation))
    assert pose.rotation @ [1.0, 0.0, 0.0] == pytest.approx(axis, abs=1e-12)
    assert pose.rotation @ [0.0, -1.0, 0.0] == pytest.approx(outward, abs=1e-12)
    assert pose.centre == pytest.approx(PLACE + 120.0 * np.array(outward), abs=1e-9)
    assert np.linalg.det(pose.rotation) == pytest.approx(1.0)
    assert pose.apply(np.array([[10.0, 0.0, 0.0]]))[0] - pose.centre == pytest.approx(10.0 * np.array(axis), abs=1e-9)


def test_the_shaft_has_any_direction_and_turns_with_the_artefact() -> None:
    above = MountGeometry(shaft_mm=120.0, shaft_direction=(0.0, 0.0, 3.0))
    assert mount_pose(PLACE, above, 0.3, 0.0).centre == pytest.approx(np.add(PLACE, [0.0, 0.0, 120.0]))
    assert mount_pose(PLACE, above, math.pi / 2, math.pi / 6).centre == pytest.approx(
        PLACE + 120.0 * np.array([0.0, -0.5, math.sqrt(0.75)])
    )
    with pytest.raises(DataError, match="shaft_direction"):
        MountGeometry(shaft_direction=(0.0, 0.0, 0.0))


def test_stations_are_evenly_spaced_inside_the_travel() -> None:
    places = station_locations(4, (0.0, 4000.0), 700.0, 1000.0, 750.0)
    assert places[:, 0] == pytest.approx([700.0, 1566.6666667, 2433.3333333, 3300.0])
    assert places[:, 1:].tolist() == [[1000.0, 750.0]] * 4
    assert station_locations(1, (0.0, 4000.0), 700.0, 0.0, 0.0)[0, 0] == 2000.0
    along_y = station_locations(2, (0.0, 900.0), 200.0, 500.0, 300.0, axis=1)
    assert along_y.tolist() == [[500.0, 200.0, 300.0], [500.0, 700.0, 300.0]]
    with pytest.raises(DataError, match="do not fit"):
        station_locations(2, (0.0, 1000.0), 700.0, 0.0, 0.0)


def test_balls_near_the_end_of_travel_are_out_of_reach() -> None:
    balls = np.array([[10.0, 50.0, 50.0], [25.0, 50.0, 50.0], [50.0, 50.0, 90.0]])
    mask = is_reachable(balls, np.zeros(3), np.full(3, 100.0), np.array([20.0, 0.0, 20.0]))
    assert mask.tolist() == [False, True, False]
