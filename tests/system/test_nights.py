"""A week of a machine that drifts and is hit: whole runs of the agent, and what only the simulator knows."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest
from campaign_command import run_campaign


@pytest.mark.long
def test_short_slots_keep_up_and_a_collision_is_noticed_named_and_calibrated(tmp_path: Path) -> None:
    table, figure = tmp_path / "nights.csv", tmp_path / "nights.png"
    code, found = run_campaign("nights", "--nights", "6", "--step", "5", "--csv", table, "--figure", figure)
    assert code == 0, found
    assert found["passed"] is True
    assert found["worst_ratio"] < 1.25, "slots of a quarter of an hour leave what full calibrations leave"
    assert found["step_named_as"].startswith("B0Z changed by +")
    assert figure.read_bytes().startswith(b"\x89PNG")
    rows = list(csv.DictReader(table.read_text().splitlines()))
    assert [row["decision"] for row in rows][-2:] == ["full calibration needed", "full calibration done"]
    before = float(rows[0]["true_before"])
    for row in rows[:5]:
        assert float(row["true_after"]) < 0.5 * before
        assert float(row["minutes"]) <= (15.0 if row["night"] != "0" else 120.0)
    # the table of the first night, left alone, falls behind with the blow
    assert float(rows[6]["untouched"]) > 2.0 * float(rows[6]["true_after"])
