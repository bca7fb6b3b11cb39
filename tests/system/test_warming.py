"""A machine and a bar that warm by 3 K while they measure each other: whole runs, and what only the simulator knows."""

from __future__ import annotations

import pytest

from campaigns.warming.trials import compare_runs


@pytest.mark.long
def test_a_table_measured_while_all_warms_is_no_worse_by_more_than_a_fifth() -> None:
    row, trace = compare_runs(1, constant=False)
    assert row.machine_k > 2.9
    assert row.artefact_k > 2.9
    assert max(trace.machine_c) > 22.9
    assert row.warm <= 1.2 * row.settled
    assert row.undrifted > 2.0 * row.warm
    assert row.untold > row.undrifted
    assert row.warm < 1.5 * row.predicted_warm
