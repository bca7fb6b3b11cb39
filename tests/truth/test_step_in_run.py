"""A machine that changes in the middle of a run, on foreign machines: found and named, or stated as invisible."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from foreign_files import Folder

from campaigns.foreign.artefact import S3, ForeignBar, tilted_bar
from campaigns.foreign.faults import FaultyRun, Measurement, crash, nothing
from campaigns.foreign.files import rows_of
from campaigns.foreign.machine import foreign_machine
from campaigns.foreign.score import family_of
from campaigns.foreign.trials import Places
from twin.artefact.observations import Observations
from twin.formats.estimate_file import parse_estimate
from twin.identification import Estimate, StepInRun, identify

FOUND = 0.01
CLOSING = FaultyRun("", closing=True).places
TRAVEL_ORDER = FaultyRun("").places
OTHER_ORDER = FaultyRun("", order="2413").places


def measurement(seed: int, change_urad: float, places: Places, position: int = 11) -> tuple[Measurement, ForeignBar]:
    rng = np.random.default_rng(seed)
    machine, bar = foreign_machine(rng), tilted_bar(rng)
    if change_urad == 0.0:
        return nothing(machine, bar, places, seed + 100), bar
    return crash(machine, bar, places, seed + 100, change_rad=1e-6 * change_urad, position=position), bar


def estimate_of(seen: Observations, bar: ForeignBar) -> Estimate:
    return identify(family_of(5).model, seen, bar.artefact, family_of(5))


@cache
def step_of(seed: int, change_urad: float, order: str = "", position: int = 11) -> StepInRun:
    places = {"": CLOSING, "1234": TRAVEL_ORDER, "2413": OTHER_ORDER}[order]
    measured, bar = measurement(seed, change_urad, places, position)
    step = estimate_of(measured.seen, bar).step
    assert step is not None
    return step


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_a_crash_is_named_with_its_place_and_size(seed: int) -> None:
    """B0Z changes before position 11; positions 11, 13 and 15 see the angle between X and Z."""
    step = step_of(seed, 12.0)
    assert step.false_alarm < FOUND
    likeliest = step.suspects[0]
    assert likeliest.jump.error == "B0Z"
    assert likeliest.jump.unit == "µrad"
    assert likeliest.jump.change == pytest.approx(12.0, rel=0.35)
    assert likeliest.last_before[0] <= 10
    assert likeliest.first_after[0] >= 11
    assert likeliest.first_after[0] - likeliest.last_before[0] <= 6
    assert "B0Z changed by +1" in likeliest.text


def test_a_crash_the_other_way_has_the_other_sign() -> None:
    assert step_of(2, -12.0).suspects[0].jump.change == pytest.approx(-12.0, rel=0.35)


@pytest.mark.parametrize("position", [5, 21])
def test_it_is_found_early_and_late(position: int) -> None:
    step = step_of(2, 30.0, position=position)
    assert step.false_alarm < FOUND
    assert step.suspects[0].last_before[0] < position <= step.suspects[0].first_after[0]


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("order", ["", "1234", "2413"])
def test_a_machine_that_does_not_change_raises_no_alarm(seed: int, order: str) -> None:
    step = step_of(seed, 0.0, order)
    assert step.false_alarm >= FOUND
    assert sum(one.probability for one in step.suspects) >= 0.95


def test_what_the_order_of_the_stations_hides_is_stated() -> None:
    """Stations in travel order hide most: a step then looks like an angular error of X that grows with the travel."""
    hidden = {order: [step_of(seed, 0.0, order).hidden for seed in range(4)] for order in ("", "1234", "2413")}
    mean = {order: float(np.mean([one.vce_um for one in found if one])) for order, found in hidden.items()}
    assert mean["1234"] > 1.3 * mean["2413"] > 1.3 * 0.7 * mean[""]
    first = hidden["1234"][0]
    assert first is not None
    assert first.between is not None
    assert first.between[0] + 1 == first.between[1]
    assert f"between positions {first.between[0]} and {first.between[1]}" in first.note


def test_the_order_of_the_rows_is_the_order_of_measuring() -> None:
    """The same balls, listed as if the positions had been measured the other way round."""
    measured, bar = measurement(2, 30.0, CLOSING)
    seen = measured.seen
    backwards = seen.select(np.lexsort((seen.ball, -seen.position)))
    step, other = (estimate_of(one, bar).step for one in (seen, backwards))
    assert step is not None
    assert other is not None
    assert other.log_ratio == pytest.approx(step.log_ratio, rel=0.1)
    assert other.suspects[0].jump.change == pytest.approx(-step.suspects[0].jump.change, rel=0.1)
    assert other.suspects[0].last_before[0] >= 11
    assert other.suspects[0].first_after[0] <= 10


def test_wrong_balls_are_no_step() -> None:
    measured, bar = measurement(3, 0.0, CLOSING)
    points, rng = measured.seen.axis_positions.copy(), np.random.default_rng(3)
    wrong = rng.choice(len(points), 4, replace=False)
    points[wrong] += 0.04 * rng.choice([-1.0, 1.0], (4, 3))
    estimate = estimate_of(replace(measured.seen, axis_positions=points), bar)
    assert len(estimate.rejected) >= 4
    assert estimate.step is not None
    assert estimate.step.false_alarm >= FOUND


def test_the_command_refuses_the_table_and_names_the_positions_of_the_file(tmp_path: Path) -> None:
    measured, bar = measurement(1, 30.0, CLOSING)
    folder = Folder(tmp_path)
    done = folder.run(bar, rows_of(measured.seen, first_position=101, per_station=len(S3)), "--order", "4", "--json")
    assert done.exit_code == 0, done.output  # `--even-so`
    assert '"step in run": false' in done.stdout
    assert "change of the machine while measuring, probability: " in done.stdout
    assert "the machine changed while it was measured: B0Z changed by +" in done.stdout
    assert "between position 110, ball" in done.stdout
    stored = parse_estimate((folder.out / "estimate.json").read_text(), "estimate.json").document.step_in_run
    assert stored is not None
    assert stored.suspects[0].error == "B0Z"
    assert stored.suspects[0].last_before[0] <= 111 < stored.suspects[0].first_after[0] + 1
