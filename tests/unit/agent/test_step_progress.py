"""Tests of the progress of a run: interruptions of a link and impairments are noted when they are new."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from agent.execution.rig import Rig
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
    rig = SimpleNamespace(link_interruptions=lambda: next(counts), impairments=dict)
    progress = StepProgress(tracker, lambda _step, _result: None, rig)  # type: ignore[arg-type]
    for number in range(4):
        progress.observe(Dwell(f"dwell-{number}", 1.0), None)
    assert [(kind, record["device"], record["interruptions"]) for kind, record in journal.events] == [
        ("note", "cnc", 1),
        ("note", "cnc", 3),
        ("note", "mount", 1),
    ]


def test_an_impaired_device_is_noted_when_it_begins_and_when_it_ends() -> None:
    lost = {"mount": ["no heartbeat of node 5"]}
    journal, impaired = Journal(), iter([{"mount": []}, lost, lost, {"mount": []}])
    tracker = RunStateTracker(journal, lambda _: None)  # type: ignore[arg-type]
    rig = SimpleNamespace(link_interruptions=dict, impairments=lambda: next(impaired))
    progress = StepProgress(tracker, lambda _step, _result: None, rig)  # type: ignore[arg-type]
    for number in range(4):
        progress.observe(Dwell(f"dwell-{number}", 1.0), None)
    assert [(record["device"], record["text"]) for _, record in journal.events] == [
        ("mount", "no heartbeat of node 5; the run goes on"),
        ("mount", "no longer: no heartbeat of node 5"),
    ]


def test_a_rig_asks_only_the_devices_that_can_say_what_is_impaired() -> None:
    mount: Any = SimpleNamespace(impairments=lambda: ["no heartbeat of node 5"])
    other: Any = SimpleNamespace()
    rig = Rig({"cnc": other, "mount": mount}, other, other, {1: mount}, other, other, other, other)
    assert rig.impairments() == {"mount": ["no heartbeat of node 5"]}
