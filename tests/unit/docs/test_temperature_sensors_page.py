"""The page about temperature sensors against its data, and the data against the program."""

from __future__ import annotations

from dataclasses import astuple
from pathlib import Path

import pytest

from campaigns.sensors.drifting_machine import KINDS, Kind
from campaigns.sensors.judged_sensors import judged
from campaigns.sensors.measured_season import scored_season
from campaigns.sensors.page_tables import machine_table, season_table, stored_machines, stored_seasons

PAGE = (Path(__file__).parents[3] / "docs" / "explanation" / "temperature-sensors.md").read_text(encoding="utf-8")
CLOSE = 1e-2
"""Relative tolerance: other processors and versions of numpy round differently."""
AGAIN = "run the campaign again, and `python -m campaigns.sensors.page_tables`"


def test_the_tables_of_the_page_are_those_of_the_data() -> None:
    for table in (machine_table(stored_machines()), season_table(stored_seasons())):
        assert table in PAGE, f"{AGAIN}:\n{table}"


@pytest.mark.parametrize("kind", KINDS)
def test_a_machine_is_judged_as_the_data_say(kind: Kind) -> None:
    stored = next(one for one in stored_machines() if one.kind == kind)
    found = judged(kind, stored.number)
    assert (found.taken, found.decoys, found.stuck, found.stated) == (
        stored.taken, stored.decoys, stored.stuck, stored.stated,
    ), AGAIN  # fmt: skip
    assert sum(found.rms_um, ()) == pytest.approx(sum(stored.rms_um, ()), rel=CLOSE), AGAIN
    assert found.left_out == pytest.approx(stored.left_out, rel=CLOSE), AGAIN


def test_a_season_is_scored_as_the_data_say() -> None:
    stored = stored_seasons()[0]
    found = scored_season(stored.number)
    assert found.taken == stored.taken
    for one, other in zip(found.hours, stored.hours, strict=True):
        for values, expected in zip(astuple(one)[1:], astuple(other)[1:], strict=True):
            assert values == pytest.approx(expected, rel=CLOSE), AGAIN
