"""Interrupt at an instant of a step, resume, compare every digit: a few interruptions of `campaigns.resume`."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_breaks_leave_no_trace_in_any_figure() -> None:
    command = [sys.executable, "-m", "campaigns.resume", "--every", "277"]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=600.0, check=False)
    found = json.loads(result.stdout.splitlines()[-1])
    assert (found["differing"], found["first"]) == (0, [])
    assert result.returncode == 0, result.stderr
    assert found["breaks"] > 10
