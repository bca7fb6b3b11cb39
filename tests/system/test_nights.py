"""A week of a machine that drifts and is hit: whole runs of the agent, and what only the simulator knows."""

from __future__ import annotations

import pytest

from benchmarks.nights import Season, played, verdict

pytestmark = pytest.mark.timeout(240)


def test_short_slots_keep_up_and_a_collision_is_noticed_named_and_calibrated() -> None:
    season = Season(nights=6, step=5)
    rows = played(season, report=False)
    found = verdict(season, rows)
    assert found["passed"], found
    assert str(found["step_named_as"]).startswith("B0Z")
    assert [row.decision for row in rows][-2:] == ["full calibration needed", "full calibration done"]
    # the drift is worth the slots: without them the first night's table has fallen behind before the collision
    assert rows[4].untouched > rows[4].true_after + 0.3
    before = rows[0].true_before
    assert all(row.true_after < 0.5 * before for row in rows if row.night != season.step)
