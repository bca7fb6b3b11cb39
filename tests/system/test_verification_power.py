"""`volcal plan --verification`: which step a verification finds and in which time, and what it says of wrong input."""

from __future__ import annotations

from functools import cache
from typing import Any

import pytest
from click.testing import CliRunner
from volcal_command import volcal_json

from agent.cli.main import main

SQUARENESS = ("A0Z", "B0Z", "C0Y")


@cache
def quick() -> dict[str, Any]:
    found: dict[str, Any] = volcal_json("plan", "--case", "quick", "--verification", "1")["verification"]
    return found


def worst(steps: list[dict[str, Any]]) -> float:
    return max(one["size"] for one in steps if one["error"] in SQUARENESS)


def test_a_verification_measures_the_fewest_positions_that_find_ten_microradians() -> None:
    found = quick()
    planned, rows = found["planned"], found["by_positions"]
    assert (found["sought_urad"], found["power"], found["false_alarm"]) == (10.0, 0.95, 0.01)
    assert worst(planned["steps"]) <= 10.0 < worst(rows[rows.index(planned) - 1]["steps"])
    assert found["fewest"]["squareness"] == planned
    assert 3 <= len(planned["positions"]) <= 8
    assert all(key.startswith("station-1/") for key in planned["positions"])
    assert planned["machine_minutes"] < 10.0


def test_more_positions_take_longer_and_find_smaller_steps() -> None:
    rows = quick()["by_positions"]
    assert [len(one["positions"]) for one in rows] == list(range(1, 1 + len(rows)))
    minutes = [one["machine_minutes"] for one in rows]
    assert minutes == sorted(minutes)
    assert worst(rows[-1]["steps"]) < worst(rows[3]["steps"])


def test_the_check_of_a_night_is_stated_with_the_limit_of_the_settings_and_its_false_alarms() -> None:
    found = quick()
    night = found["night"]
    assert night["step_evidence"] == 8.0 > found["planned"]["step_evidence"]
    assert 0.0 < night["false_alarm"] < 0.01
    assert worst(night["steps"]) > worst(found["planned"]["steps"])


def test_errors_that_do_not_move_the_tool_are_named() -> None:
    """The only lever arm of the tool of the case study lies along Y."""
    assert quick()["no_effect"] == ["EBY", "EBZ"]
    assert {"EBY", "EBZ"}.isdisjoint(one["error"] for one in quick()["planned"]["steps"])


def test_an_angle_that_few_touches_cannot_show_is_not_promised() -> None:
    """A rotation of the ram by 10 µrad changes the place of a tool of 250 mm by 2.5 µm over the travel."""
    assert quick()["fewest"]["squareness_or_rotation"] is None


@pytest.mark.parametrize(("case", "station", "said"), [("quick", "9", "station 9"), ("hand-placed", "1", "by hand")])
def test_a_station_where_nothing_can_be_verified_is_refused(case: str, station: str, said: str) -> None:
    result = CliRunner().invoke(main, ["plan", "--case", case, "--verification", station])
    assert result.exit_code != 0
    assert said in result.output
