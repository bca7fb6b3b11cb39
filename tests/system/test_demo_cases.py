"""`volcal demo --case` with shipped machines besides the case study: a vertical spindle, in the long form also one
without a mount, a gantry and a router."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from long_form import size

CASES = ("quick", "mill", "hand-placed", "router", "bridge")
OTHER_NAMES = {"hand-placed": "mill", "quick": "case-study"}
"""Machines of cases that are not called like them."""
BETTER_THAN_STATED = {"quick"}
"""Cases whose table happens to be better than the lower of the limits that hold for 95 of 100 machines."""


@pytest.mark.parametrize("case", CASES[: size(2, len(CASES))])
def test_shipped_case_becomes_better_as_predicted(case: str, tmp_path: Path) -> None:
    ended = subprocess.run(
        [sys.executable, "-m", "agent.cli.main", "demo", "--case", case, "--json", "--out", str(tmp_path / "out")],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=600.0,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
    document = json.loads(ended.stdout)
    assert document["state"] == "complete"
    assert document["verified"] is True
    assert document["collisions"] == 0
    assert (document["case"], document["machine"]) == (case, OTHER_NAMES.get(case, case))
    assert document["true_ve_after_um"] <= 0.5 * document["true_ve_before_um"]
    before, after = document["figures"]
    assert before["inside"]
    assert after["inside"] or (case in BETTER_THAN_STATED and after["true_um"] < after["limits_um"][0])
