"""Places of the stations: the error that they leave is that of settings with these places, and a minimum."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from agent.planning.case_file import load_case, shipped_case
from agent.planning.design.set_valuation import valuation_of
from agent.planning.job import Job
from agent.planning.job_preparation import prepare_job
from agent.planning.planning_options import planning_options
from twin.arrays import Array
from twin.artefact.position_set import CHECKABLE_BALLS, Position
from twin.design.station_places import STEP_SHARES, StationPlaces
from twin.design.valuation import valuation
from twin.identification.instruments.kinds import LaserSetUp, Readings, laser_line
from twin.machine.volumetric import evaluation_grid

BRIDGE = shipped_case("bridge").settings
POSITIONS = (Position(1, 0.0, 0.0), Position(1, 90.0, 45.0), Position(2, 45.0, 0.0), Position(4, -45.0, 45.0))


@cache
def bridge() -> Job:
    return load_case(BRIDGE)


def search(kept: tuple[int, ...] = ()) -> StationPlaces:
    job = bridge()
    return StationPlaces(
        procedure=job.procedure,
        positions=POSITIONS,
        family=job.machine.family,
        options=planning_options(job.settings.temperature),
        grid=evaluation_grid(job.machine.model.ranges_mm),
        tool_offset=job.tool_offset_mm,
        travel_mm=job.machine.limits[job.layout.station_axis],
        kept=kept,
    )


@cache
def improved(kept: tuple[int, ...] = ()) -> Mapping[int, Array]:
    return search(kept).improved()


def shifted(places: Mapping[int, Array], station: int, by_mm: float) -> dict[int, Array]:
    return {**places, station: places[station] + by_mm * np.eye(3)[bridge().layout.station_axis]}


def test_the_error_is_that_of_settings_with_these_places() -> None:
    settings = bridge().settings
    places = {**bridge().layout.locations_mm, 1: np.array([900.0, 700.0, 200.0]), 4: np.array([2000.0, 1500.0, 200.0])}
    listed = settings.stations.model_copy(update={"places_mm": [tuple(places[n].tolist()) for n in (1, 2, 3, 4)]})
    job = prepare_job(settings.model_copy(update={"stations": listed}), BRIDGE.parent)
    assert search().expected_mm(places) == pytest.approx(valuation_of(job, POSITIONS).after.aligned_mm, rel=1e-9)


def test_readings_of_an_instrument_count() -> None:
    """The expected error with them is that of the same set in the valuation, which is smaller than without them."""
    job = bridge()
    ranges = np.array(job.machine.model.ranges_mm)
    points = np.tile(ranges.mean(axis=1), (10, 1))
    points[:, 0] = np.linspace(ranges[0, 0], ranges[0, 1], 10)
    seen = Readings("laser.csv", np.zeros(10), np.full(10, 0.2e-3), job.tool_offset_mm)
    laser = laser_line(seen, points, LaserSetUp(0.1))
    given = search()
    joined = replace(given, options=replace(given.options, instruments=(laser,)))
    places = job.layout.locations_mm
    planned = job.procedure.plan(POSITIONS).observations
    whole = valuation(
        job.machine.family, job.procedure.artefact, planned, joined.options, given.grid, given.tool_offset
    )
    assert joined.expected_mm(places) == pytest.approx(whole.after.aligned_mm, rel=1e-9)
    assert joined.expected_mm(places) < 0.99 * given.expected_mm(places)


def test_the_places_lower_the_error_and_no_small_step_lowers_it_further() -> None:
    places, travel = improved(), bridge().machine.limits[bridge().layout.station_axis]
    before, after = search().expected_mm(bridge().layout.locations_mm), search().expected_mm(places)
    assert after < 0.99 * before
    step = 5.0 * round(STEP_SHARES[-1] * (travel[1] - travel[0]) / 5.0)
    for station in (1, 2, 4):
        for by_mm in (-step, step):
            trial = shifted(places, station, by_mm)
            if travel[0] <= trial[station][bridge().layout.station_axis] <= travel[1]:
                assert search().expected_mm(trial) >= (1.0 - 2e-4) * after


def test_stations_move_along_their_axis_only_and_those_that_need_not_move_stay() -> None:
    along, stated = bridge().layout.station_axis, bridge().layout.locations_mm
    for kept in ((), (1,)):
        moved = {station for station, place in improved(kept).items() if not np.array_equal(place, stated[station])}
        assert moved
        assert moved.isdisjoint({3, *kept})  # nothing is measured at station 3
        for station in moved:
            assert np.array_equal(np.delete(improved(kept)[station], along), np.delete(stated[station], along))


def test_a_place_at_which_a_position_loses_its_balls_counts_as_useless() -> None:
    far = shifted(bridge().layout.locations_mm, 1, -1000.0)
    there = replace(bridge().procedure, layouts={bridge().settings.tool: bridge().layout.with_locations(far)})
    assert min(len(there.balls_of(position)[0]) for position in POSITIONS) < CHECKABLE_BALLS
    assert search().expected_mm(far) == np.inf
