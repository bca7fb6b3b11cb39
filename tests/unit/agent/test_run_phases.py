"""Phases of a run: spans of a plan, the phase that the status shows, and the preflight of the run before."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from agent.cli.service_commands.status import show
from agent.execution.journal import Journal
from agent.execution.run_state import Announcement
from agent.execution.states import RunState
from agent.execution.steps import Dwell, MoveTo, TouchTowards
from agent.planning.run_phases import (
    HOMING,
    MEASURING,
    PREFLIGHT,
    PROBE_CHECK,
    QUALIFICATION,
    REVERSAL,
    VERIFICATION,
    PhaseSpan,
    phase_spans,
)
from agent.runs.run_start import last_preflight
from agent.runs.step_progress import FormerPreflight
from agent.service.daemon.main_loop import status_text
from agent.service.state.event_log import EventLog
from agent.service.state.status_board import StatusBoard
from drivers.clock import VirtualClock
from drivers.roles import Miss, Touch

PROBE = "probe/station-2/az0-el45"
TIMELINE = {
    "before/active-bank": 0.0,
    f"{PROBE}/enter": 10.0,
    f"{PROBE}/ball-00/check/touch-0": 30.0,
    f"{PROBE}/ball-00/qualify/touch-0": 40.0,
    f"{PROBE}/ball-00/reversal/X/place-0/touch-0": 55.0,
    f"{PROBE}/off-ball": 60.0,
    "homing/0/home": 90.0,
    "homing/leave": 95.0,
    "measure/permissions": 95.0,
    "measure/change-1/ask": 300.0,
    "measure/station-1/az0-el45/ball-00/touch-0": 310.0,
    "publish/stage": 310.0,
    "verify/station-1/az0-el45/ball-00/touch-0": 400.0,
    "state/complete": 400.0,
}


def test_the_phases_of_a_plan_cover_its_time_without_a_gap() -> None:
    """The way off the ball belongs to the last check, the carrying of the artefact to what it is carried for."""
    assert phase_spans(TIMELINE) == (
        PhaseSpan(PROBE_CHECK, 0.0, 30.0),
        PhaseSpan(QUALIFICATION, 30.0, 40.0),
        PhaseSpan(REVERSAL, 40.0, 60.0),
        PhaseSpan(HOMING, 60.0, 95.0),
        PhaseSpan(MEASURING, 95.0, 310.0),
        PhaseSpan(VERIFICATION, 310.0, 400.0),
    )
    assert phase_spans({"before/active-bank": 0.0}) == ()


def told(board: StatusBoard, kind: str, **data: Any) -> None:
    board.on_announcement(Announcement(kind, "", data))


def progress(phase: str, fraction: float) -> dict[str, Any]:
    return {"phase": phase, "phase_fraction": fraction, "phase_minutes_left": 1.0, "fraction": 0.5, "minutes_left": 9.0}


def test_the_status_of_a_service_that_knows_no_phases_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    status = vars(StatusBoard("mill", EventLog(), VirtualClock().now).status())
    show({key: value for key, value in status.items() if key != "receivers" and "phase" not in key}, as_json=False)
    assert "accepted requests" in capsys.readouterr().out


def test_the_status_names_the_phase_from_the_request_to_the_end() -> None:
    board = StatusBoard("mill", EventLog(), VirtualClock().now)
    assert board.status().phase == ""
    board.begin_run("run", "calibrate", "page", "S3")
    assert (board.status().phase, board.status().phase_fraction) == (PREFLIGHT, None)
    told(board, "progress", phase=PREFLIGHT, phase_fraction=0.5, fraction=0.0, minutes_left=None, simulated_steps=700)
    assert (board.status().phase_fraction, board.status().simulated_steps) == (0.5, 700)

    told(board, "progress", **progress(PROBE_CHECK, 0.0))
    told(board, "state", state="measuring")
    board.on_step(Dwell(f"{PROBE}/ball-00/check/touch-0", 1.0), None)
    assert (board.status().phase, board.status().minutes_left) == (PROBE_CHECK, 9.0)
    assert board.status().doing.startswith("checking the probe: station 2")
    told(board, "state", state="held")
    assert (board.status().phase, board.status().phase_minutes_left) == (PROBE_CHECK, 1.0)
    told(board, "state", state="measuring")
    told(board, "progress", **progress(MEASURING, 0.9))
    assert (board.status().phase, board.status().phase_fraction) == (MEASURING, 0.9)

    for state in ("identifying", "staging", "activating"):
        told(board, "state", state=state)
        told(board, "progress", **progress(VERIFICATION, 0.0))  # the steps that write belong to no other phase
        assert (board.status().phase, board.status().phase_fraction) == (state, None)
    told(board, "state", state="verifying")
    assert (board.status().phase, board.status().phase_fraction) == (VERIFICATION, 0.0)
    told(board, "progress", **progress(VERIFICATION, 0.7))
    told(board, "state", state="held")
    told(board, "state", state="verifying")
    assert board.status().phase_fraction == 0.7
    board.enter(RunState.COMPLETE, "ended")
    assert (board.status().phase, board.status().phase_minutes_left) == ("", None)


@pytest.mark.parametrize(("kind", "found"), [("calibrate", FormerPreflight(900, 12.0)), ("verify", None)])
def test_the_preflight_of_the_last_run_of_the_same_kind_is_the_measure(
    tmp_path: Path, kind: str, found: FormerPreflight | None
) -> None:
    journal = Journal(tmp_path)
    try:
        for number, (of, former) in enumerate((("calibrate", 800), ("calibrate", 900), ("nightly", 300))):
            run = journal.start_run(f"run-{number}", of, {}, "1.2.3", VirtualClock())
            run.origin({})
            run.event("note", {"text": "a thermometer is impaired"})
            run.event("note", {"text": "preflight passed", **FormerPreflight(former, 12.0).as_record()})
            run.begun()
        refused = journal.start_run("run-refused", "calibrate", {}, "1.2.3", VirtualClock())
        refused.origin({})
    finally:
        journal.close()
    assert last_preflight(tmp_path, kind) == found


@pytest.mark.parametrize("said", [{}, {"planning_seconds": "soon"}, {"planning_seconds": None}])
def test_a_damaged_note_on_a_former_preflight_refuses_no_run(tmp_path: Path, said: dict[str, Any]) -> None:
    journal = Journal(tmp_path)
    run = journal.start_run("run-0", "calibrate", {}, "1.2.3", VirtualClock())
    run.origin({})
    run.event("note", {"text": "preflight passed", "simulated_steps": 900, **said})
    run.begun()
    journal.close()
    assert last_preflight(tmp_path, "calibrate") is None


def test_the_command_and_systemd_state_the_phase(capsys: pytest.CaptureFixture[str]) -> None:
    board = StatusBoard("mill", EventLog(), VirtualClock().now)
    board.begin_run("run", "calibrate", "page", "S3")
    told(board, "progress", phase=PREFLIGHT, phase_fraction=None, fraction=0.0, minutes_left=None, simulated_steps=700)
    show(vars(board.status()), as_json=False)
    assert "preflight, 700 steps simulated" in capsys.readouterr().out
    assert "700 steps simulated" in status_text(board.status())
    told(board, "progress", **progress(QUALIFICATION, 0.4))
    show(vars(board.status()), as_json=False)
    assert "qualification, 40 %, 1 min left" in capsys.readouterr().out
    assert "50 %, 9 min left" in status_text(board.status())


def test_the_status_tells_where_the_run_has_led_the_axes() -> None:
    board = StatusBoard("mill", EventLog(), VirtualClock().now)
    board.begin_run("run", "calibrate", "page", "S3")
    told(board, "state", state="measuring")
    assert board.status().axis_mm is None
    board.on_step(MoveTo("a", (1.0, 2.0, 3.0)), None)
    assert board.status().axis_mm == (1.0, 2.0, 3.0)
    board.on_step(TouchTowards("b", (1.0, 2.0, 0.0), 5.0), Touch((1.0, 2.0, 2.5)))
    assert board.status().axis_mm == (1.0, 2.0, 2.5)
    board.on_step(TouchTowards("c", (4.0, 2.0, 0.0), 5.0), Miss((4.0, 2.0, 0.1)))
    assert board.status().axis_mm == (4.0, 2.0, 0.1)
    board.enter(RunState.ABORTED, "stopped")  # from now on, anybody may move them
    assert board.status().axis_mm is None
