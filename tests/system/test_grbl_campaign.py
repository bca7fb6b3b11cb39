"""A small part of the trial `make grbl`: every kind of disturbance once, on grblHAL."""

from __future__ import annotations

from campaign_command import run_campaign


def test_every_disturbance_ends_well_and_the_run_itself_makes_the_machine_better() -> None:
    _, result = run_campaign("grbl", "--events", "14", "--workers", "1", "--dialect", "grblhal")
    assert result["failures"] == []
    assert result["passed"]
    assert set(result["by_kind"].values()) == {1}
    assert len(result["by_kind"]) == 14
