"""Several artefacts in one estimate: combination, refusals, and separate certificates."""

from __future__ import annotations

from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest

from twin.artefact.artefact import Artefact, ball_bar
from twin.artefact.combined_artefact import combine_artefacts
from twin.artefact.mount_geometry import MountGeometry
from twin.artefact.position_set import Position
from twin.collision.measuring_layout import MeasuringLayout
from twin.collision.neighbour_stations import neighbour_bodies
from twin.collision.probe_geometry import ProbeGeometry
from twin.design.procedure import Procedure
from twin.errors import DataError

BAR = ball_bar(
    "bar", balls=5, length_mm=600.0, tilt_rad=0.2, holder_length_mm=60.0, ball_diameter_mm=25.0,
    standard_uncertainty_mm=1e-3, certificate="first",
)  # fmt: skip


def other(shift_mm: float = 0.1) -> Artefact:
    rng = np.random.default_rng(3)
    balls = BAR.balls + shift_mm * rng.uniform(-1.0, 1.0, BAR.balls.shape)
    return replace(BAR, name="other", certificate="second", balls=balls, covariance=4.0 * BAR.covariance)


def test_balls_and_certificates_stand_one_after_the_other_and_know_nothing_of_each_other() -> None:
    both = combine_artefacts([BAR, other()])
    assert both.count == 10
    assert both.members == (0,) * 5 + (1,) * 5
    assert np.array_equal(both.balls[5:], other().balls)
    assert np.array_equal(both.covariance[:15, :15], BAR.covariance)
    assert np.array_equal(both.covariance[15:, 15:], 4.0 * BAR.covariance)
    assert not both.covariance[:15, 15:].any()
    assert (both.name, both.certificate) == ("bar + other", "first; second")


def test_balls_of_two_artefacts_may_have_one_place_and_those_of_one_may_not() -> None:
    assert combine_artefacts([BAR, replace(BAR)]).count == 10
    with pytest.raises(DataError, match="less than their diameter"):
        replace(BAR, balls=np.zeros_like(BAR.balls))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"ball_diameter_mm": 20.0}, "ball_diameter_mm"),
        ({"cte_per_k": 2e-6}, "cte_per_k"),
        ({"sag_mm": 0.01}, "sag_mm"),
        ({"balls": BAR.balls[:4], "covariance": BAR.covariance[:12, :12]}, "4 balls"),
    ],
)
def test_artefacts_of_different_kinds_are_refused(change: dict[str, object], said: str) -> None:
    with pytest.raises(DataError, match=said):
        combine_artefacts([BAR, replace(BAR, **change)])  # type: ignore[arg-type]


def layout(own: dict[int, Artefact], around: bool = True) -> MeasuringLayout:
    places = {1: np.array([900.0, 1000.0, 750.0]), 2: np.array([2000.0, 1000.0, 750.0])}
    mount = MountGeometry()
    return MeasuringLayout(
        artefact=combine_artefacts(list(own.values())) if own else BAR,
        mount=mount,
        probe=ProbeGeometry(),
        locations_mm=MappingProxyType(places),
        tool_offset_mm=np.array([0.0, 250.0, 0.0]),
        lower_mm=np.zeros(3),
        upper_mm=np.array([4000.0, 1300.0, 1500.0]),
        contact_mm=15.5,
        approach_mm=8.0,
        own_artefacts=own,
        neighbours=neighbour_bodies(mount, places, own, (0.0, 90.0)) if around else {},
    )


def test_a_procedure_counts_the_balls_of_the_second_artefact_on() -> None:
    own = {1: BAR, 2: other()}
    planned = Procedure({"probe": layout(own)}, np.eye(3) * 1e-6).plan([Position(1, 0.0, 0.0), Position(2, 0.0, 0.0)])
    seen = planned.observations
    assert seen.ball.tolist() == [*range(5), *range(5, 10)]
    moved = seen.axis_positions[5:] - seen.axis_positions[:5] - [1100.0, 0.0, 0.0]
    assert np.allclose(moved, other().balls - BAR.balls)
    assert planned.unreachable_balls == 0


def test_every_station_sees_the_other_mount_parked_with_what_it_carries() -> None:
    around = layout({1: BAR, 2: other()}).neighbours
    names = {body.name for body in around[1]}
    assert "ball 4 at station 2" in names
    assert "pedestal at station 2" in names
    assert not any("station 1" in name or "table" in name for name in names)
    upright = [body for body in around[1] if body.name == "bar at station 2"]
    assert max(body.shape.upper[2] for body in upright) == pytest.approx(750.0 + 300.0 + 15.0 + 15.0, abs=0.1)
    assert max(body.shape.upper[0] for body in upright) == pytest.approx(2000.0 + 15.0, abs=0.1)
    bare = layout({}).neighbours[1]
    assert {body.name for body in bare} == {"shaft at station 2", "pedestal at station 2"}


def test_a_ball_behind_a_neighbour_is_not_offered() -> None:
    """Place the stations 500 mm apart: the bar of station 1 at azimuth 0 ends where the bar parked at station 2 blocks
    the ram.
    """
    near = layout({1: BAR, 2: other()})
    places = {1: np.array([900.0, 1000.0, 750.0]), 2: np.array([1200.0, 850.0, 750.0])}
    around = neighbour_bodies(near.mount, places, near.own_artefacts, (0.0, 90.0))
    crowded = replace(near, locations_mm=places, neighbours=around)
    alone = replace(near, locations_mm=places, neighbours={})
    position = Position(1, 0.0, 0.0)
    assert alone.accessible(position).all()
    assert crowded.accessible(position).tolist() == [True, True, True, True, False]
