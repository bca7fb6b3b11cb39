"""Held-out positions of the case study: chosen where the position set does not reach, or as the settings list them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from agent.planning import held_out_positions as module
from agent.planning.case_file import CASE_STUDY, load_case, shipped_case
from agent.planning.design.feasibility import FeasibilityCheck
from agent.planning.held_out_positions import (
    held_out_grid,
    held_out_positions,
    least_known,
    verification_stations,
)
from agent.planning.job import Job
from agent.planning.job_preparation import prepare_job, reached_balls
from agent.results.predicted_accuracy import planned_estimate, predict_accuracy
from agent.runs.kinds.calibrate import preflight_of
from agent.runs.kinds.position_choice import PositionChooser
from agent.settings.load import load_settings
from agent.settings.schema import Settings
from drivers.errors import ConfigurationError
from twin.artefact.position_set import MIN_BALLS, Position
from twin.compensation.table import MeasuredRegion

IN_THE_MIDDLE = [(30.0, 30.0), (-30.0, -30.0)]


@cache
def case() -> Job:
    return load_case(CASE_STUDY)


def settings_with(**verification: object) -> Settings:
    chosen = case().settings
    return chosen.model_copy(update={"verification": chosen.verification.model_copy(update=verification)})


def prepared(**verification: object) -> Job:
    return prepare_job(settings_with(**verification), CASE_STUDY.parent)


def share_outside(job: Job, position: Position) -> float:
    """Return the share of the balls of `position` beyond the convex hull of the measured balls."""
    hull = MeasuredRegion.around(job.procedure.plan(job.positions).observations.axis_positions, margin_mm=0.0)
    return float((~hull.contains(job.procedure.balls_of(position)[1])).mean())


def test_the_proof_looks_beyond_what_the_set_reaches() -> None:
    """The fourth position is one of several whose expected errors differ by 1 %, so it alone may lie mostly inside."""
    job = case()
    assert len(set(job.held_out)) == 4
    assert not set(job.held_out) & set(job.positions)
    for position in job.held_out:
        assert position.station in (1, 4)
        assert len(job.procedure.balls_of(position)[0]) >= MIN_BALLS
    shares = sorted(share_outside(job, position) for position in job.held_out)
    assert shares[0] > 0.05
    assert shares[1] > 0.15
    assert np.mean(shares) > 0.2
    heights = job.procedure.plan(job.positions).observations.axis_positions[:, 2]
    reached = np.concatenate([job.procedure.balls_of(position)[1][:, 2] for position in job.held_out])
    assert reached.min() < heights.min() - 100.0
    assert reached.max() > heights.max() + 100.0


def test_chosen_positions_are_expected_to_be_worse_than_those_in_the_middle() -> None:
    chosen, listed = (
        predict_accuracy(job, preflight_of(job).measured).held_out_um
        for job in (case(), prepared(positions_deg=IN_THE_MIDDLE))
    )
    assert list(chosen) == list(case().held_out)
    assert min(chosen.values()) > max(listed.values())


def test_the_choice_is_the_same_every_time_and_fits_the_set() -> None:
    job = case()
    assert prepared().held_out == job.held_out
    assert job.verified_stations == tuple(dict.fromkeys(position.station for position in job.held_out))
    best = least_known(job, job.positions, (1, 4), 1)[0]
    others = held_out_positions(job, (*job.positions, best))
    assert best in job.held_out
    assert best not in others


def test_the_choice_is_made_when_it_is_first_read_and_copies_share_it(monkeypatch: pytest.MonkeyPatch) -> None:
    choices: list[int] = []

    def refuse(*_: object) -> tuple[Position, ...]:
        choices.append(1)
        raise ConfigurationError("nothing can be held out", key="verification.grid_deg")

    with monkeypatch.context() as patch:
        patch.setattr(module, "least_known", refuse)
        job = prepared()
        with pytest.raises(ConfigurationError, match="nothing can be held out"):
            preflight_of(job)
    assert choices == [1]
    fewer = replace(job, positions=job.positions[:3])
    assert fewer.held_out is job.held_out
    assert job.held_out == case().held_out


def test_a_chosen_position_can_be_measured() -> None:
    job = case()
    feasibility = FeasibilityCheck(job)
    assert [feasibility.hit(position) for position in job.held_out] == ["", "", "", ""]


@pytest.mark.parametrize("name", ["mill", "router", "bridge"])
def test_with_plain_paths_no_chosen_position_rises_above_the_retreat_plane_of_a_vertical_machine(name: str) -> None:
    """On these machines some orientations rise above the retreat plane. They are accessible, but a plain path hits
    them."""
    file = shipped_case(name).settings
    settings = load_settings(file)
    plain = settings.procedure.model_copy(update={"paths": "plain"})
    job = prepare_job(settings.model_copy(update={"procedure": plain}), file.parent)
    feasibility, station = FeasibilityCheck(job), verification_stations(job.settings)[0]
    offered = [Position(station, *angles) for angles in held_out_grid(job.settings)]
    assert any(feasibility.hit(position) for position in offered if reached_balls(job, position) >= MIN_BALLS)
    flat = next(position for position in job.positions if position.station == station and position.elevation_deg == 0.0)
    preflight = preflight_of(replace(job, positions=(flat,)))
    assert len(preflight.verified.positions) == len(job.held_out)


def test_listed_orientations_are_held_out_at_every_station() -> None:
    job = prepared(positions_deg=IN_THE_MIDDLE)
    assert job.held_out == tuple(Position(station, *angles) for station in (1, 4) for angles in IN_THE_MIDDLE)
    assert job.verified_stations == (1, 4)


@pytest.mark.parametrize("axis", ["X", "Z"])
def test_a_night_holds_out_the_position_that_shows_a_change_of_the_machine(axis: str) -> None:
    """A changed scale of an axis shows best on a bar that lies along this axis."""
    job = case()
    prior = planned_estimate(job, job.procedure.plan(job.positions).observations).carried_over()
    chooser, change = PositionChooser(job, 2), np.zeros([prior.unknowns.model.size] * 2)
    index = prior.unknowns.model.names.index(f"E{axis}{axis}[1]")
    change[index, index] = 1.0
    (chosen,) = chooser.held_out(prior, change, 1)
    along = {
        Position(2, azimuth, elevation): share_along(axis, azimuth, elevation)
        for azimuth, elevation in held_out_grid(job.settings)
    }
    offered = {position: share for position, share in along.items() if position not in job.positions}
    measurable = [share for position, share in offered.items() if not chooser.feasibility.hit(position)]
    assert chosen in offered
    assert offered[chosen] == pytest.approx(max(measurable), abs=0.2)


def share_along(axis: str, azimuth_deg: float, elevation_deg: float) -> float:
    azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
    return abs(float(np.sin(elevation) if axis == "Z" else np.cos(elevation) * np.cos(azimuth)))


def test_a_night_holds_out_listed_positions() -> None:
    listed = prepared(positions_deg=IN_THE_MIDDLE)
    prior = planned_estimate(listed, listed.procedure.plan(listed.positions).observations).carried_over()
    change = np.eye(prior.unknowns.model.size)
    offered = {Position(2, *angles) for angles in IN_THE_MIDDLE}
    chooser = PositionChooser(listed, 2)
    assert set(chooser.held_out(prior, change, 2)) == offered
    assert set(chooser.held_out(prior, change, 1)) < offered


def test_a_grid_that_does_not_divide_a_right_angle_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="does not divide 90") as caught:
        prepared(grid_deg=25.0)
    assert caught.value.where["key"] == "verification.grid_deg"


@pytest.mark.parametrize(("step_deg", "says"), [(7.0, "does not divide 90"), (0.5, "is less than 2.5°")])
def test_a_wrong_grid_of_nights_is_refused_before_a_night_chooses_on_it(step_deg: float, says: str) -> None:
    settings = load_settings(CASE_STUDY)
    nightly = settings.nightly.model_copy(update={"grid_deg": step_deg})
    with pytest.raises(ConfigurationError, match=says) as caught:
        prepare_job(settings.model_copy(update={"nightly": nightly}), CASE_STUDY.parent)
    assert caught.value.where["key"] == "nightly.grid_deg"
