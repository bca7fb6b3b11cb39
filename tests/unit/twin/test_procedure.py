"""Planned measurement of a position set, before anything moves."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from twin.artefact.artefact import ball_bar
from twin.artefact.mount_geometry import MountGeometry
from twin.artefact.position_set import Position
from twin.artefact.touch_pattern import approach_directions, centre_covariance
from twin.collision.measuring_layout import MeasuringLayout
from twin.collision.probe_geometry import ProbeGeometry
from twin.design.procedure import Procedure
from twin.errors import DataError
from twin.formats.position_set_file import format_positions, parse_positions

BAR = ball_bar("bar", balls=5, length_mm=1000.0, tilt_rad=0.0, holder_length_mm=60.0, ball_diameter_mm=25.0)
LAYOUT = MeasuringLayout(
    artefact=BAR,
    mount=MountGeometry(),
    probe=ProbeGeometry(),
    locations_mm={1: np.array([1000.0, 1000.0, 750.0])},
    tool_offset_mm=np.array([0.0, 250.0, 0.0]),
    lower_mm=np.zeros(3),
    upper_mm=np.array([4000.0, 1300.0, 1500.0]),
    contact_mm=15.5,
    approach_mm=8.0,
)
LONGER = dataclasses.replace(LAYOUT, tool_offset_mm=np.array([0.0, 450.0, 0.0]), probe=ProbeGeometry(reach_mm=450.0))
PROCEDURE = Procedure({"probe": LAYOUT, "longer": LONGER}, np.eye(3) * 1e-6)


def test_balls_of_a_level_bar_stand_where_a_ruler_puts_them() -> None:
    planned = PROCEDURE.plan([Position(1, 0.0, 0.0)])
    x = [500.0, 750.0, 1000.0, 1250.0, 1500.0]
    # 120 mm of shaft and 60 mm of holder from the mount towards the ram, minus the tool offset
    expected = [(at, 1000.0 - 120.0 - 60.0 - 250.0, 750.0) for at in x]
    np.testing.assert_allclose(planned.observations.axis_positions, expected, atol=1e-9)


def test_balls_beyond_the_travel_are_left_out_and_counted() -> None:
    near_the_end = dataclasses.replace(LAYOUT, locations_mm={1: np.array([260.0, 1000.0, 750.0])})
    planned = Procedure({"probe": near_the_end}, np.eye(3)).plan([Position(1, 0.0, 0.0)])
    assert planned.observations.ball.tolist() == [1, 2, 3, 4]
    assert planned.unreachable_balls == 1


def test_a_bar_across_the_travel_of_y_is_left_out() -> None:
    both = [Position(1, 90.0, 0.0), Position(1, 45.0, 0.0)]
    planned = PROCEDURE.plan(both)
    assert planned.left_out == (both[0],)
    assert planned.positions == (both[1],)
    with pytest.raises(DataError, match="none of the 1 positions"):
        PROCEDURE.plan(both[:1])


def test_each_position_is_measured_with_its_tool() -> None:
    planned = PROCEDURE.plan([Position(1, 0.0, 0.0), Position(1, 0.0, 0.0, "longer")])
    seen = planned.observations
    assert seen.tool.tolist() == [0] * 5 + [1] * 5
    np.testing.assert_allclose(seen.axis_positions[:5] - seen.axis_positions[5:], np.tile([0.0, 200.0, 0.0], (5, 1)))
    with pytest.raises(DataError, match="'lateral' is not part of the procedure"):
        PROCEDURE.plan([Position(1, 0.0, 0.0, "lateral")])


def test_an_unknown_station_is_named() -> None:
    with pytest.raises(DataError, match="station 7 has no location"):
        PROCEDURE.plan([Position(7, 0.0, 0.0)])


def test_covariance_of_a_centre_is_that_of_plain_least_squares() -> None:
    directions = approach_directions(9, np.array([0.0, 1.0, 0.0]))
    design = np.column_stack((directions, np.ones(9)))
    expected = np.linalg.inv(design.T @ design)[:3, :3] * 1.1e-3**2
    np.testing.assert_allclose(centre_covariance(directions, 1.1e-3), expected, rtol=1e-6, atol=1e-15)
    five = centre_covariance(approach_directions(5, np.array([0.0, 1.0, 0.0])), 1e-3)
    assert math.sqrt(five[0, 0]) == pytest.approx(1e-3 / math.sqrt(2.0), rel=1e-6)


def test_a_set_of_several_tools_survives_its_file() -> None:
    positions = (Position(1, 45.0, 0.0), Position(2, -30.5, 15.0, "longer"))
    text = format_positions(positions)
    assert text.splitlines()[0] == "station,azimuth_deg,elevation_deg,tool"
    assert parse_positions(text, "set.csv") == positions
    assert format_positions(positions[:1]).splitlines()[0] == "station,azimuth_deg,elevation_deg"
