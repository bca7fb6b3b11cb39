"""What a run has measured of lost motion and repeatability, read from its journal."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.execution.journal import Journal
from agent.execution.states import RunState
from agent.language.sentences import german
from agent.workpiece.measured_repeats import measured_repeats
from drivers.clock import VirtualClock
from twin.workpiece.positioning import AxisRepeats


def test_an_estimate_that_is_not_that_of_a_run_has_none(tmp_path: Path) -> None:
    found = measured_repeats(tmp_path)
    assert found.axes == {}
    assert found.not_measured == ("not measured: A, A±, E, R, R±, B: the estimate is not in the folder of a run",)


AXES: list[dict[str, Any]] = [
    {"axis": "X", "lost_um": 3.0, "sigma_um": 0.4, "verdict": "within", "scatter_um": 0.8, "freedom": 13},
    {"axis": "Y", "lost_um": None, "sigma_um": None, "verdict": "could not be measured: a touch met nothing"},
    {"axis": "Z", "lost_um": -1.0, "sigma_um": 0.5, "verdict": "within"},
]
REPEATABILITY = {"two_sigma_um": 2.0, "touches": 10}


def a_run(state: Path, decisions: dict[str, dict[str, object]]) -> Path:
    """Return the folder of a run with these decisions in its journal."""
    journal = Journal(state)
    try:
        run = journal.start_run("one", "calibrate", {}, "1.2.3", VirtualClock())
        for kind, record in decisions.items():
            run.decision(kind, record)
        run.state(RunState.COMPLETE, final=True)
    finally:
        journal.close()
    (state / "one").mkdir()
    return state / "one"


def test_each_axis_gets_what_was_measured_of_it(tmp_path: Path) -> None:
    reversal = {"axes": AXES, "at_mm": [100.0, 200.0, 300.0], "text": "", "limit_um": 5.0}
    decisions: dict[str, dict[str, Any]] = {
        "probe/ball-00/check/repeatability": dict(REPEATABILITY),
        "probe/ball-00/reversal/reversal": dict(reversal),
    }
    folder = a_run(tmp_path, decisions)
    for path in (folder, folder / "estimate.json"):
        found = measured_repeats(path)
        assert found.axes["X"] == AxisRepeats(0.8e-3, 13, 3e-3, 0.4e-3, 100.0)
        assert found.axes["Z"] == AxisRepeats(1e-3, 9, -1e-3, 0.5e-3, 300.0)  # of an earlier version: touches of a pole
        assert found.axes["Y"].figures == ("A±", "R±")
        assert found.not_measured == (
            "not measured: A Y, E Y, R Y, B Y: the run did not measure its lost motion (settings `[reversal]`)",
        )


def test_a_run_without_its_checks_says_what_is_missing(tmp_path: Path) -> None:
    found = measured_repeats(a_run(tmp_path, {}))
    assert all(one.figures == () for one in found.axes.values())
    assert len(found.not_measured) == 3
    assert "[reversal]" in found.not_measured[0]
    assert "[probe_check]" in found.not_measured[0]
    assert german(found.not_measured[0]) == (
        "nicht gemessen: A X, A± X, E X, R X, R± X, B X: der Lauf hat ihr Umkehrspiel (Einstellungen `[reversal]`) und "
        "die Wiederholbarkeit von Antastungen (mindestens 4, Einstellungen `[probe_check]`) nicht gemessen"
    )


@pytest.mark.parametrize(
    ("touches", "expected"),
    [
        (3, AxisRepeats(np.sqrt((1 * 0.8**2 + 2 * 1.0**2) / 3) * 1e-3, 3, 3e-3, 0.4e-3, 100.0)),
        (0, AxisRepeats(None, 0, 3e-3, 0.4e-3, 100.0)),
    ],
)
def test_a_scatter_of_too_few_touches_is_pooled_with_those_of_a_pole_or_not_stated(
    tmp_path: Path, touches: int, expected: AxisRepeats
) -> None:
    """One touch from either side leaves one degree of freedom."""
    decisions: dict[str, dict[str, Any]] = {
        "probe/ball-00/reversal/reversal": {"axes": [{**AXES[0], "freedom": 1}], "at_mm": [100.0, 200.0, 300.0]}
    }
    if touches:
        decisions["probe/ball-00/check/repeatability"] = {"two_sigma_um": 2.0, "touches": touches}
    found = measured_repeats(a_run(tmp_path, decisions)).axes["X"]
    assert (found.freedom if found.scatter_mm else 0) == expected.freedom
    assert found.scatter_mm == (None if expected.scatter_mm is None else pytest.approx(expected.scatter_mm))
    assert (found.lost_mm, found.at_mm) == (expected.lost_mm, expected.at_mm)


def test_a_folder_beside_a_journal_that_is_no_run_has_none(tmp_path: Path) -> None:
    a_run(tmp_path, {})
    (tmp_path / "other").mkdir()
    assert measured_repeats(tmp_path / "other").axes == {}
