"""Lost motion and a sagging bar, which shift the balls alike in all positions: found and named."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from foreign_files import Folder

from campaigns.foreign.artefact import S3, ForeignBar, straight_bar, tilted_bar
from campaigns.foreign.faults import (
    Fault,
    FaultyRun,
    Measurement,
    lag,
    nothing,
    play,
    play_by_side,
    sag,
    shifted_by_direction,
)
from campaigns.foreign.files import rows_of
from campaigns.foreign.machine import GRID, TOOL, foreign_machine
from campaigns.foreign.score import family_of, true_error_um
from twin.formats.estimate_file import parse_estimate
from twin.identification import PatternTest, identify, identify_by_evidence
from twin.identification.predicted import expected_vce, field_forms

FOUND = 0.01
PLACES = FaultyRun("").places


def measurement(seed: int, fault: Fault, worse: float = 1.0) -> tuple[Measurement, ForeignBar]:
    rng = np.random.default_rng(seed)
    bar = straight_bar(rng, 0.01) if seed % 2 else tilted_bar(rng)
    return fault(foreign_machine(rng, worse), bar, PLACES, seed + 100), bar


def pattern_of(seed: int, fault: Fault, worse: float = 1.0) -> PatternTest:
    measured, bar = measurement(seed, fault, worse)
    pattern = identify(family_of(5).model, measured.seen, bar.artefact, family_of(5)).pattern
    assert pattern is not None
    return pattern


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_an_axis_that_reverses_at_the_same_ball_is_named(seed: int, axis: int) -> None:
    pattern = pattern_of(seed, partial(play, axis=axis, ball=6))
    assert pattern.false_alarm < FOUND
    likeliest = pattern.suspects[0]
    assert likeliest.cause == f"{'XYZ'[axis]} shifted in each position"
    assert " from ball 7 of each position on" in likeliest.text
    assert abs(likeliest.size_um) == pytest.approx(10.0, rel=0.4)
    assert likeliest.probability > 0.9


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_an_axis_that_is_shifted_on_one_side_of_its_travel_is_named(seed: int, axis: int) -> None:
    pattern = pattern_of(seed, partial(play_by_side, axis=axis))
    assert pattern.false_alarm < FOUND
    assert pattern.suspects[0].cause == f"{'XYZ'[axis]} shifted on one side of {'XYZ'[axis]}"
    assert abs(pattern.suspects[0].size_um) == pytest.approx(10.0, rel=0.4)


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_an_axis_that_lags_in_the_direction_of_its_motion_is_estimated(seed: int, axis: int) -> None:
    measured, bar = measurement(seed, partial(lag, axis=axis))
    found = identify_by_evidence(family_of, measured.seen, bar.artefact)
    [shift] = found.shifts
    assert shift.name == f"lost motion {'XYZ'[axis]}"
    assert shift.size_um == pytest.approx(10.0, abs=4.0 * shift.standard_uncertainty_um)
    assert shift.standard_uncertainty_um < 1.0
    assert found.pattern is not None
    assert found.pattern.false_alarm >= FOUND
    # the first ball of a position may lie within 0.5 mm of the last one before: the direction is then not known
    assert {ball for _, ball, _ in found.rejected} <= {0}
    assert len(found.rejected) <= 2
    predicted_um = expected_vce(found, field_forms(found, GRID, TOOL)).aligned_um
    assert true_error_um(measured.machine, found) < 1.2 * predicted_um < 5.0


@pytest.mark.parametrize("stated", [True, False])
@pytest.mark.parametrize("seed", [1, 2])
def test_the_sag_of_a_bar_is_estimated(seed: int, stated: bool) -> None:
    measured, bar = measurement(seed, partial(sag, ends_mm=0.02))
    doubt_mm = 0.0 if stated else bar.artefact.expected_sag_mm
    artefact = replace(bar.artefact, sag_standard_uncertainty_mm=doubt_mm)
    found = identify_by_evidence(family_of, measured.seen, artefact)
    [shift] = found.shifts
    assert shift.name == "sag"
    assert shift.size_um == pytest.approx(20.0, abs=4.0 * shift.standard_uncertainty_um)
    assert shift.standard_uncertainty_um < 1.5
    assert found.found_sag_mm == pytest.approx(1e-3 * shift.size_um)
    assert found.pattern is not None
    assert found.pattern.false_alarm >= FOUND
    # straightness of the machine over its travel is 4 times that over the bar, and so is the effect of a wrong sag
    assert true_error_um(measured.machine, found) < 1.5 * without_fault_um(seed)


def test_both_axes_that_lag_are_estimated() -> None:
    first, bar = measurement(2, partial(lag, axis=0))
    both = shifted_by_direction(first.seen, axis=1, lost_mm=0.006)
    found = identify(family_of(5).model, both, bar.artefact, family_of(5))
    sizes_um = {shift.name: shift.size_um for shift in found.shifts}
    assert sizes_um == {"lost motion X": pytest.approx(10.0, abs=2.0), "lost motion Y": pytest.approx(6.0, abs=2.0)}


def without_fault_um(seed: int) -> float:
    measured, bar = measurement(seed, nothing)
    return true_error_um(measured.machine, identify_by_evidence(family_of, measured.seen, bar.artefact))


@pytest.mark.parametrize("worse", [0.1, 1.0, 3.0])
@pytest.mark.parametrize("seed", range(6))
def test_balls_without_a_pattern_raise_no_alarm(seed: int, worse: float) -> None:
    assert pattern_of(seed, nothing, worse).false_alarm >= FOUND


def test_the_command_refuses_the_table_and_names_the_axis(tmp_path: Path) -> None:
    measured, bar = measurement(2, partial(play, axis=2, ball=6))
    folder = Folder(tmp_path)
    done = folder.run(bar, rows_of(measured.seen, per_station=len(S3)), "--order", "4", "--json")
    assert done.exit_code == 0, done.output  # `--even-so`
    said = json.loads(done.stdout)
    assert said["gates"]["pattern"] is False
    assert said["gates"]["step in run"] is True
    assert "pattern of shifts, probability: " in said["reason"]
    assert said["shift_pattern"]["suspects"][0]["text"].startswith("Z shifted in each position by ")
    stored = parse_estimate((folder.out / "estimate.json").read_text(), "estimate.json").document.shift_pattern
    assert stored is not None
    assert stored.model_dump(mode="json") == said["shift_pattern"]


def test_the_command_tells_the_sag_that_it_took_into_account(tmp_path: Path) -> None:
    measured, bar = measurement(2, partial(sag, ends_mm=0.02))
    folder = Folder(tmp_path)
    done = folder.run(bar, rows_of(measured.seen, per_station=len(S3)), "--order", "4", "--json")
    assert done.exit_code == 0, done.output
    said = json.loads(done.stdout)
    assert said["gates"]["pattern"] is True
    [shift] = said["ball_shifts"]
    assert shift["name"] == "sag"
    assert shift["size_um"] == pytest.approx(20.0, abs=4.0)
