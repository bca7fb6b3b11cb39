"""Interrupt at an instant of a step, resume, compare every digit: a few interruptions of `campaigns.resume`."""

from __future__ import annotations

from campaign_command import run_campaign


def test_breaks_leave_no_trace_in_any_figure() -> None:
    code, found = run_campaign("resume", "--every", "499")
    assert (found["differing"], found["first"]) == (0, [])
    assert code == 0
    assert found["breaks"] > 10
