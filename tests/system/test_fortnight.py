"""A fortnight in five evenings: the real service, a timer, and everything that goes wrong on the way."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_every_incident_leaves_the_history_and_the_table_that_it_should(tmp_path: Path) -> None:
    table = tmp_path / "fortnight.csv"
    done = subprocess.run(
        [sys.executable, "-m", "campaigns.fortnight", "--thin", "--csv", str(table)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=600.0,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["passed"] is True
    assert found["failed"] == []
    assert found["ends"] == ["complete", "faulted", "complete", "aborted", "refused"]
    assert found["decisions"][-1] == "full calibration needed"
    assert "B0Z changed by +" in found["named"]
    assert found["collisions"] == 0
    rows = list(csv.DictReader(table.read_text().splitlines()))
    assert [row["incident"] for row in rows][-2:] == ["abort", "damage"]
    # an interrupted run has changed nothing: the former table is as good as it was
    for row in (rows[1], rows[3]):
        assert row["true_after"] == row["true_before"]
