"""A small part of the trial `make crash-points`."""

from __future__ import annotations

from campaign_command import run_campaign

from campaigns.faults.night_record import INVARIANTS


def test_a_run_that_is_killed_anywhere_is_resumed_or_taken_back() -> None:
    """A dozen of kills, about 35 s of CPU time."""
    selected = ("--every", "800", "--every-other", "12", "--seed", "2", "--only-accepted")
    code, result = run_campaign("crash_points", *selected, "--workers", "1")
    assert result["violations"] == dict.fromkeys(INVARIANTS, 0)
    assert (code, result["passed"]) == (0, True)
    assert result["points"] > 5000
    assert result["kills"] >= 10
    assert result["resumed_and_accepted"] > 0
