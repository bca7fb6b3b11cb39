"""A short form of the trial with foreign machines, `python -m campaigns.foreign`."""

from __future__ import annotations

import numpy as np
import pytest

from campaigns.foreign.artefact import S3, STATIONS_MM, measure, tilted_bar
from campaigns.foreign.machine import GRID, TOOL
from campaigns.foreign.score import family_of, true_error_um
from campaigns.foreign.sine_machine import sine_machine
from campaigns.foreign.trials import SETS, one_machine, places_of, summary
from twin.identification import identify, predicted_vce

MACHINES = 10


def test_a_designed_set_has_twenty_positions_at_four_stations() -> None:
    places = places_of("designed")
    assert [station for station, _ in places] == list(STATIONS_MM)
    assert sum(len(orientations) for _, orientations in places) == 20
    assert places_of("S3") == [(station, S3) for station in STATIONS_MM]


@pytest.mark.parametrize(
    ("trial", "generator"), [("S3", "mixed"), ("designed", "mixed"), ("S3", "sines"), ("S1+S2+S3", "sines")]
)
def test_what_is_stated_is_true(trial: str, generator: str) -> None:
    judged = [one_machine(trial, generator, number)[1] for number in range(MACHINES)]
    found = summary(judged)
    assert found["true_after_um"] < 0.45 * found["true_before_um"]
    assert 0.8 < found["ratio"] < 1.15
    assert found["ve_percent"] >= 70.0
    assert found["vce_percent"] >= 70.0
    assert 88.0 < found["field_ball_by_ball_percent"] < 99.0


def test_sines_too_short_to_be_resolved_are_counted_as_errors_that_stay() -> None:
    """The ball centres scatter more than the touches do, because the machine has errors between the balls. They stay
    after compensation."""
    family, ratios = family_of(8), []
    for number in range(4):
        rng = np.random.default_rng([number, 5])
        machine, bar = sine_machine(rng, largest_sine=4.0), tilted_bar(rng)
        seen = measure(machine, bar, SETS["S1+S3"], rng).seen
        estimate = identify(family.model, seen, bar.artefact, family)
        assert estimate.misfit is not None
        assert estimate.scales.noise > 1.1
        assert estimate.misfit.unresolved_mm2 > 0.9 * (estimate.scales.noise**2 - 1.0) * seen.coordinate_variance_mm2
        ratios.append(true_error_um(machine, estimate) / predicted_vce(estimate, GRID, TOOL).aligned_um)
    assert 0.9 < float(np.mean(ratios)) < 1.1


def test_nights_are_judged_as_whole_runs_are() -> None:
    kinds, judged = one_machine("nights", "mixed", 0)
    assert len(kinds.split()) == 3
    assert judged.after_um < 0.6 * judged.before_um
    assert 0.0 <= judged.vce_rank <= 1.0
