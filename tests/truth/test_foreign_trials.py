"""A short form of the trial with foreign machines, `python -m campaigns.foreign`."""

from __future__ import annotations

import pytest

from campaigns.foreign.artefact import S3, STATIONS_MM
from campaigns.foreign.trials import one_machine, places_of, summary

MACHINES = 10


def test_a_designed_set_has_twenty_positions_at_four_stations() -> None:
    places = places_of("designed")
    assert [station for station, _ in places] == list(STATIONS_MM)
    assert sum(len(orientations) for _, orientations in places) == 20
    assert places_of("S3") == [(station, S3) for station in STATIONS_MM]


@pytest.mark.parametrize("trial", ["S3", "designed"])
def test_what_is_stated_is_true(trial: str) -> None:
    judged = [one_machine(trial, number)[1] for number in range(MACHINES)]
    found = summary(judged)
    assert found["true_after_um"] < 0.4 * found["true_before_um"]
    assert 0.8 < found["ratio"] < 1.15
    assert found["ve_percent"] >= 70.0
    assert found["vce_percent"] >= 70.0
    assert 90.0 < found["field_ball_by_ball_percent"] < 99.0


def test_nights_are_judged_as_whole_runs_are() -> None:
    kinds, judged = one_machine("nights", 0)
    assert len(kinds.split()) == 3
    assert judged.after_um < 0.6 * judged.before_um
    assert 0.0 <= judged.vce_rank <= 1.0
