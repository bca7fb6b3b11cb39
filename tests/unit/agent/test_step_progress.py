"""Tests of the progress of a run: interruptions of a link are noted when they are new."""

from __future__ import annotations

from typing import Any

from agent.execution.run_state import RunStateTracker
from agent.execution.steps import Dwell
from agent.runs.step_progress import StepProgress


class Journal:
    def __init__(self) -> None:
        self.events: list[tuple[str, dict[str, Any]]] = []

    def event(self, kind: str, record: dict[str, Any]) -> None:
        self.events.append((kind, record))


def test_each_interruption_of_a_link_is_noted_once() -> None:
    journal, counts = Journal(), iter([{"cnc": 0}, {"cnc": 1}, {"cnc": 1}, {"cnc": 3, "mount": 1}])
    tracker = RunStateTracker(journal, lambda _: None)  # type: ignore[arg-type]
    progress = StepProgress(tracker, lambda _step, _result: None, lambda: next(counts))
    for number in range(4):
        progress.observe(Dwell(f"dwell-{number}", 1.0), None)
    assert [(kind, record["device"], record["interruptions"]) for kind, record in journal.events] == [
        ("note", "cnc", 1),
        ("note", "cnc", 3),
        ("note", "mount", 1),
    ]
