"""A fortnight in five evenings: the real service, a timer, and everything that goes wrong on the way."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest
from campaign_command import run_campaign


@pytest.mark.long
def test_every_incident_leaves_the_history_and_the_table_that_it_should(tmp_path: Path) -> None:
    table = tmp_path / "fortnight.csv"
    code, found = run_campaign("fortnight", "--thin", "--csv", table)
    assert code == 0, found
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
