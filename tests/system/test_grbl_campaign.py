"""A small part of the trial `make grbl`: every kind of disturbance once, on grblHAL."""

from __future__ import annotations

import json
import subprocess
import sys


def test_every_disturbance_ends_well_and_the_run_itself_makes_the_machine_better() -> None:
    command = [sys.executable, "-m", "campaigns.grbl", "--events", "14", "--workers", "1", "--dialect", "grblhal"]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=600.0, check=False)
    assert ended.stdout, ended.stderr
    result = json.loads(ended.stdout.splitlines()[-1])
    assert result["failures"] == []
    assert result["passed"]
    assert set(result["by_kind"].values()) == {1}
    assert len(result["by_kind"]) == 14
