"""Whole run interrupted in every way at every n-th step, and at every step around its tables."""

from __future__ import annotations

from campaign_command import run_campaign

STEPS_WITHOUT_MACHINE = 5
"""Steps after the last motion: what was verified, the proof, its verdict, the accepted table, the end."""


def test_the_former_table_is_active_after_every_exit() -> None:
    code, result = run_campaign("aborts", "--every", "400", "--workers", "1")
    assert result["failures"] == []
    assert result["ends_failed"] == []
    assert code == 0
    assert result["aborts"] > 300
    assert result["completed_before_noticed"] <= 2 * STEPS_WITHOUT_MACHINE, "an abort or a fault after the last motion"
    ways = result["by_way"]
    assert {"abort before", "abort middle", "link once middle", "fault middle", "disk full before"} <= set(ways)
