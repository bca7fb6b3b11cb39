"""A small part of the trial `make power-cuts`, and what it finds where a synchronisation is left out."""

from __future__ import annotations

from pathlib import Path

import pytest
from aloud import NOT_HERE
from campaign_command import run_campaign

from campaigns.power_cuts.recorded_calls import works

EVERY = "7"
LEFT_OUT: list[tuple[str, ...]] = [
    ("--synchronous", "NORMAL"),
    ("--ignore", "journal.sqlite"),
    ("--ignore", "journal.sqlite-wal"),
    ("--ignore", ".result.txt.*"),
    ("--ignore", "state"),
    ("--ignore", "disk"),
    ("--ignore", ".estimate.json.gz.*", "--every", "7"),
]
"""Mode of the journal that loses commits, and names of files and directories."""


@pytest.fixture(autouse=True)
def strace(tmp_path: Path) -> None:
    if not works(tmp_path):
        pytest.skip(f"{NOT_HERE}: power cuts at each system call: no process can be traced by strace")


def test_nothing_acknowledged_is_lost_by_a_power_cut() -> None:
    code, result = run_campaign("power_cuts", "--every", EVERY)
    assert result["listed"] == []
    assert (code, result["passed"], result["lost"]) == (0, True, 0)
    assert result["acknowledged"] > 100
    assert min(result["cuts"].values()) > 100


@pytest.mark.parametrize("left_out", LEFT_OUT, ids=" ".join)
def test_a_synchronisation_that_is_left_out_loses_something(left_out: tuple[str, ...]) -> None:
    code, result = run_campaign("power_cuts", "--every", "23", *left_out)
    assert code == 1
    assert result["lost"] > 0
