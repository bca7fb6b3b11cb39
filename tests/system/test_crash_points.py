"""A small part of the trials `make crash-points` and `make crash-points KIND=processes`."""

from __future__ import annotations

from campaign_command import run_campaign

from campaigns.crash_points import process_kills
from campaigns.faults.invariants import INVARIANTS
from campaigns.sum import form_of


def test_a_run_that_is_killed_anywhere_is_resumed_or_taken_back() -> None:
    """A dozen of kills, about 35 s of CPU time."""
    selected = ("--every", "800", "--every-other", "12", "--seed", "2", "--only-accepted")
    code, result = run_campaign("crash_points", *selected, "--workers", "1")
    assert result["violations"] == dict.fromkeys(INVARIANTS, 0)
    assert (code, result["passed"]) == (0, True)
    assert result["points"] > 5000
    assert result["kills"] >= 10
    assert result["resumed_and_accepted"] > 0
    assert form_of(result).name == "crash_points"


def test_a_service_and_a_machine_that_are_killed_lose_nothing_and_leave_no_unproved_table() -> None:
    """Some kills of real processes, about 25 s of CPU time: the runs between them are whole ones."""
    code, result = run_campaign("crash_points", "--kind", "processes", "--kills", "6", "--seed", "2")
    assert result["violations"] == dict.fromkeys(process_kills.INVARIANTS, 0)
    assert (code, result["passed"]) == (0, True)
    assert result["kills"] >= 6
    assert {one.split(",")[0] for one in result["kills_by_kind"]} == {"service", "machine"}
    assert result["accepted"] > 0
