"""Tests of the progress of a run: interruptions of a link and impairments are noted when they are new, and the phases
are announced from the first step on."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from agent.errors import Aborted
from agent.execution.rig import Rig
from agent.execution.run_state import Announcement, RunStateTracker
from agent.execution.steps import Dwell
from agent.planning.case_file import CASE_STUDY, load_case
from agent.planning.run_phases import PREFLIGHT, PROBE_CHECK, QUALIFICATION, REVERSAL
from agent.planning.time_model import time_model
from agent.runs.kinds.calibrate import preflight_of
from agent.runs.run_forecast import RunForecast
from agent.runs.step_progress import FormerPreflight, StepProgress
from drivers.clock import VirtualClock


class Journal:
    def __init__(self) -> None:
        self.events: list[tuple[str, dict[str, Any]]] = []

    def event(self, kind: str, record: dict[str, Any]) -> None:
        self.events.append((kind, record))


def quiet_rig() -> Any:
    return SimpleNamespace(link_interruptions=dict, impairments=dict, clock=VirtualClock())


def test_the_progress_is_told_at_the_start_and_only_when_it_has_changed() -> None:
    job = load_case(CASE_STUDY)
    preflight = preflight_of(job)
    heard: list[Announcement] = []
    progress = StepProgress(RunStateTracker(Journal(), heard.append), lambda _, __: None, quiet_rig())  # type: ignore[arg-type]
    progress.begin(RunForecast(preflight, time_model(job.machine, job.settings.timing), job.held_out))
    (first,) = heard
    assert (first.kind, first.data["fraction"], first.data["phase"]) == ("progress", 0.0, PROBE_CHECK)
    assert first.data["minutes_left"] * 60.0 == pytest.approx(preflight.machine_seconds)
    for timed in preflight.steps:
        progress.observe(timed.step, None)
    assert [one.data["phase"] for one in heard if one.data["phase_fraction"] == 0.0].count(PROBE_CHECK) == 1
    before_balls = [one for one in heard if one.data["phase"] in (PROBE_CHECK, QUALIFICATION, REVERSAL)]
    assert len(before_balls) > 50  # two minutes before the first measured ball
    assert 200 < len(heard) < len(preflight.steps) / 2


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


def test_a_preflight_tells_its_steps_and_its_fraction_if_a_former_one_is_known() -> None:
    former = FormerPreflight.of({"simulated_steps": 800, "planning_seconds": 3600.0})
    for expected, fractions in ((None, {None}), (former, {None, 0.25, 0.5, 0.75, 0.99})):
        heard: list[Announcement] = []
        checked: list[None] = []
        progress = StepProgress(RunStateTracker(Journal(), heard.append), lambda _, __: None, quiet_rig())  # type: ignore[arg-type]
        watch = progress.simulating(lambda checked=checked: checked.append(None), expected)  # type: ignore[misc]
        for _ in range(1000):
            watch()
        assert len(checked) == progress.preflight.steps == 1000
        assert [one.data["simulated_steps"] for one in heard] == [0, 200, 400, 600, 800, 1000]
        assert {one.data["phase_fraction"] for one in heard} == fractions
        left = [one.data["phase_minutes_left"] for one in heard]
        assert left == ([None] * 6 if expected is None else sorted(left, reverse=True))
        assert {(one.kind, one.data["phase"], one.data["minutes_left"]) for one in heard} == {
            ("progress", PREFLIGHT, None)
        }
        assert FormerPreflight.of(progress.preflight.as_record()).steps == 1000


def test_a_preflight_that_is_stopped_counts_no_further_step() -> None:
    def stop() -> None:
        raise Aborted("stop")

    progress = StepProgress(RunStateTracker(Journal(), lambda _: None), lambda _, __: None, quiet_rig())  # type: ignore[arg-type]
    with pytest.raises(Aborted):
        progress.simulating(stop, None)()
    assert progress.preflight.steps == 0


def test_a_rig_asks_only_the_devices_that_can_say_what_is_impaired() -> None:
    mount: Any = SimpleNamespace(impairments=lambda: ["no heartbeat of node 5"])
    other: Any = SimpleNamespace()
    rig = Rig({"cnc": other, "mount": mount}, other, other, {1: mount}, other, other, other, other)
    assert rig.impairments() == {"mount": ["no heartbeat of node 5"]}
