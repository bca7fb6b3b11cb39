"""Lost motion and a sagging bar, which shift the balls alike in all positions: found and named."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from foreign_files import Folder, rows_of

from campaigns.foreign.artefact import S3, ForeignBar, straight_bar, tilted_bar
from campaigns.foreign.faults import Fault, FaultyRun, Measurement, nothing, play, play_by_side, sag
from campaigns.foreign.machine import foreign_machine
from campaigns.foreign.score import family_of
from twin.formats.estimate_file import parse_estimate
from twin.identification import PatternTest, identify

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
def test_a_bar_that_sags_is_named_with_its_sag(seed: int) -> None:
    pattern = pattern_of(seed, partial(sag, ends_mm=0.02))
    assert pattern.false_alarm < FOUND
    assert pattern.suspects[0].cause == "the ends of the bar hang lower than its file states"
    assert pattern.suspects[0].size_um == pytest.approx(20.0, rel=0.2)


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
    assert "gate pattern: " in said["reason"]
    assert said["shift_pattern"]["suspects"][0]["text"].startswith("Z shifted in each position by ")
    stored = parse_estimate((folder.out / "estimate.json").read_text(), "estimate.json").document.shift_pattern
    assert stored is not None
    assert stored.model_dump(mode="json") == said["shift_pattern"]
