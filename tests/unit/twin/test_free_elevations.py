"""Elevations at which the artefact is clear of the table and of the pedestal, against plain trigonometry."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from twin.artefact.artefact import Artefact, ball_bar
from twin.artefact.artefact_body import ArtefactBody, Beam, Rod
from twin.artefact.mount_geometry import MountGeometry
from twin.collision.free_elevations import CLEARANCE_MM, free_elevations

BESIDE = MountGeometry(shaft_mm=100.0, pedestal_radius_mm=40.0, table_z_mm=-500.0)


def bar_with_holders_up() -> Artefact:
    bar = ball_bar(
        "bar", balls=5, length_mm=400.0, tilt_rad=0.0, holder_length_mm=40.0, ball_diameter_mm=20.0,
    )  # fmt: skip
    up = np.column_stack([bar.balls[:, 0], bar.balls[:, 2], -bar.balls[:, 1]])
    return replace(bar, balls=up, body=ArtefactBody(beam=Beam(radius_mm=12.0, overhang_mm=12.0)))


@pytest.mark.parametrize("height_mm", [60.0, 132.0, 200.0])
def test_a_low_mount_limits_the_elevation(height_mm: float) -> None:
    # the round end of the beam is 212 mm from the elevation axis and 12 mm thick
    steepest_deg = math.degrees(math.asin((height_mm - 12.0 - CLEARANCE_MM) / 212.0))
    found = free_elevations(bar_with_holders_up(), BESIDE, height_mm)
    assert found.obstacle == "table"
    assert found.upper_deg == math.floor(steepest_deg)
    assert found.lower_deg == -math.floor(steepest_deg)
    assert found.contains(steepest_deg - 1.0)
    assert not found.contains(steepest_deg + 1.0)


def test_a_high_mount_leaves_every_elevation() -> None:
    found = free_elevations(bar_with_holders_up(), BESIDE, 400.0)
    assert (found.lower_deg, found.upper_deg, found.obstacle) == (-90.0, 90.0, "")


def test_a_bar_on_the_table_has_no_free_elevation() -> None:
    found = free_elevations(bar_with_holders_up(), BESIDE, 10.0)
    assert not found.contains(0.0)
    assert found.obstacle == "table"


def test_the_pedestal_stops_a_beam_that_swings_against_it() -> None:
    # The beam is 90 mm above the elevation axis and clear of a pedestal that ends 20 mm above this axis.
    bar = bar_with_holders_up()
    above = MountGeometry(
        shaft_mm=90.0, shaft_direction=(0.0, 0.0, 1.0), pedestal_radius_mm=24.0, head_mm=20.0, table_z_mm=-500.0
    )
    assert free_elevations(bar, above, 1000.0).obstacle == ""
    # a rod of 20 mm that hangs from the beam, 100 mm beside the pedestal, to 60 mm below the elevation axis
    rod = Rod("foot", (100.0, 0.0, 0.0), (100.0, 0.0, -150.0), 10.0)
    found = free_elevations(replace(bar, body=replace(bar.body, parts=(rod,))), above, 1000.0)
    assert found.obstacle == "pedestal"
    # At the elevation -e its lower end is 100 cos e - 60 sin e beside the axis of the pedestal; 10 + 24 + 2 mm are
    # reached at e = acos(36 / sqrt(100² + 60²)) - atan(60 / 100).
    stop_deg = math.degrees(math.acos(36.0 / math.hypot(100.0, 60.0)) - math.atan(0.6))
    assert found.lower_deg == -math.floor(stop_deg)
    assert found.upper_deg == 90.0


def test_a_hanging_mount_is_the_mirror_image_of_a_standing_one() -> None:
    bar = bar_with_holders_up()
    standing = MountGeometry(shaft_mm=90.0, shaft_direction=(0.0, 0.0, 1.0), pedestal_radius_mm=40.0)
    below = replace(bar, balls=bar.balls * (1.0, 1.0, -1.0))
    hanging = replace(standing, shaft_direction=(0.0, 0.0, -1.0), hanging=True)
    for height_mm in (100.0, 150.0, 220.0):
        above, under = free_elevations(bar, standing, height_mm), free_elevations(below, hanging, height_mm)
        assert (under.lower_deg, under.upper_deg) == (-above.upper_deg, -above.lower_deg)
        assert under.obstacle == above.obstacle == "table"


def test_a_fork_under_the_middle_of_a_bar_limits_the_elevation() -> None:
    """The bar turns about its own middle. Its axis comes as near to the end of the pedestal's axis as the distance
    times the cosine of the elevation."""
    bar = ball_bar(
        "bar", balls=3, length_mm=800.0, tilt_rad=0.0, holder_length_mm=60.0, ball_diameter_mm=20.0,
    )  # fmt: skip
    bar = replace(bar, body=ArtefactBody(beam=Beam(radius_mm=12.0, overhang_mm=12.0)))
    fork = MountGeometry(shaft_mm=0.0, pedestal_radius_mm=40.0, head_mm=-150.0, table_z_mm=-500.0)
    steepest_deg = math.degrees(math.acos((40.0 + 12.0 + CLEARANCE_MM) / 150.0))
    found = free_elevations(bar, fork, 1000.0)
    assert found.obstacle == "pedestal"
    assert found.upper_deg == pytest.approx(steepest_deg, abs=1.0)
    assert found.lower_deg == pytest.approx(-steepest_deg, abs=1.0)
