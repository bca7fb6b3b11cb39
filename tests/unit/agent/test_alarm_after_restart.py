"""An alarm keeps its number, cause, remedy and place when the service is restarted, until a reset acknowledges it."""

from __future__ import annotations

from pathlib import Path

import pytest
from journal_surgery import operate
from journaled import SETTINGS
from service_house import House, house

from agent.errors import Aborted, GateRefused, Interrupted, JournalFailed
from agent.execution.journal import Journal
from agent.execution.journal_reader import open_journal
from agent.execution.states import RunState
from agent.runs.reconcile_result import CompensationState, ReconcileAction, Reconciliation
from agent.runs.run_request import RunRequest
from agent.service.alarms import CODES, DEFECT
from agent.service.control import Alarm
from agent.service.state.alarm_list import alarm_page
from agent.service.state.controller_reading import ControllerReading
from agent.service.state.idle_alarms import ENDPOINT
from drivers.clock import VirtualClock
from drivers.errors import LinkLost, MotionFault, VolcalError

CALIBRATE = RunRequest(kind="calibrate", source="page", consent=True)
LOST = LinkLost("no answer from 10.0.0.7", hint="plug it in", device="cnc").at(step="station-1/ball-02")


def journal_run(state: Path, run_id: str, ends: RunState, fault: BaseException | None = None) -> None:
    """Write what a run leaves in the journal that ends so; if it is still measuring, it has no end."""
    journal = Journal(state)
    try:
        run = journal.start_run(run_id, "calibrate", SETTINGS, "1.2.3", VirtualClock())
        run.state(RunState.PREFLIGHT)
        if ends is not RunState.REFUSED:
            run.state(RunState.MEASURING)
        if fault is not None:
            run.fault(fault)
        if ends is not RunState.MEASURING:
            run.state(ends, str(fault), final=True)
    finally:
        journal.close()


def ended(built: House, state: Path, ends: RunState, error: VolcalError) -> Alarm:
    """Carry out a run that ends with `error`, and return the alarm that the service shows."""
    run_id = built.owner.start(CALIBRATE)
    built.puppet.begun()
    journal_run(state, run_id, ends, error)
    built.puppet.end(ends, error)
    assert built.owner.wait(600.0)
    (alarm,) = built.owner.status().alarms
    return alarm


@pytest.mark.parametrize(
    ("ends", "error"),
    [
        (RunState.FAULTED, LOST),
        (RunState.ABORTED, Aborted("abort pressed")),
        (RunState.ABORTED, Interrupted("the service is being stopped")),
        (RunState.REFUSED, GateRefused("the fit is worse than its limit", hint="clean the balls")),
    ],
)
def test_an_alarm_is_the_same_after_a_restart(tmp_path, ends, error) -> None:
    with house(tmp_path) as before:
        alarm = ended(before, tmp_path, ends, error)
        assert alarm.code == CODES[type(error)].code
    with house(tmp_path) as after:
        status = after.owner.status()
        assert status.state is ends
        assert status.alarms == (alarm,)
        after.owner.reset()
        assert after.owner.status().alarms == ()
    with house(tmp_path) as acknowledged:
        status = acknowledged.owner.status()
        assert (status.state, status.alarms) == (RunState.IDLE, ())


def test_an_alarm_between_runs_is_listed_and_the_same_after_a_restart(tmp_path: Path) -> None:
    lost = Reconciliation(CompensationState.LOST, ReconcileAction.NOTHING, 1, instruction="look at the controller")
    endpoint = Alarm(203, "the service goes on without OPC UA", where={ENDPOINT: "OPC UA"})
    with house(tmp_path) as before:
        before.machine.found.append(lost)
        before.owner.reconcile_if_reached()
        (alarm,) = before.owner.status().alarms
        before.parts.board.idle_alarm(endpoint)
        assert [one.alarm for one in alarm_page(tmp_path, 1, 1).alarms] == [alarm]
    with house(tmp_path) as after:
        assert after.owner.status().alarms == (alarm,)  # whether the endpoint opens now is another matter
        after.machine.found.append(lost)
        after.owner.reconcile_if_reached()
        assert after.owner.status().alarms == (alarm,)
        page = alarm_page(tmp_path, 10, 0)
        assert page.total == 2
        assert {(one.alarm.code, one.run_id, one.until is None) for one in page.alarms} == {
            (203, "", False),
            (alarm.code, "", True),
        }
        assert "reset" in after.owner.status().may
        after.owner.reset()
        assert "reset" not in after.owner.status().may
        assert all(one.until for one in alarm_page(tmp_path, 10, 0).alarms)
    operate(tmp_path, "DROP TABLE idle_alarms")  # a journal of an earlier program
    assert alarm_page(tmp_path, 10, 0).total == 0
    with house(tmp_path) as acknowledged:
        assert acknowledged.owner.status().alarms == ()


@pytest.mark.parametrize("mended", [False, True])
def test_a_reset_that_cannot_compare_keeps_the_alarm_until_the_next_reading(tmp_path: Path, mended: bool) -> None:
    lost = Reconciliation(CompensationState.LOST, ReconcileAction.NOTHING, 0, instruction="look at the controller")
    expected = Reconciliation(CompensationState.AS_EXPECTED, ReconcileAction.NOTHING, 0)
    with house(tmp_path) as built:
        built.machine.found.append(lost)
        built.owner.reconcile_if_reached()
        (alarm,) = built.owner.status().alarms
        built.machine.away.append(LinkLost("no answer"))
        built.owner.reset()
        status = built.owner.status()
        assert (status.alarms, status.doing, status.active_bank) == ((alarm,), "not ready: an alarm is open", None)
        assert (status.read_problem, "reset" in status.may) == ("no answer", True)
        assert [one.until for one in alarm_page(tmp_path, 10, 0).alarms] == [None]
        built.machine.found.append(expected if mended else lost)
        built.machine.readings.extend([ControllerReading((), 0), ControllerReading((), 0)])
        built.owner.read_idle()
        built.owner.read_idle()
        status = built.owner.status()
        assert (status.alarms, status.active_bank) == (() if mended else (alarm,), 0)
        assert [one.until is None for one in alarm_page(tmp_path, 10, 0).alarms].count(True) == len(status.alarms)
        assert status.doing == ("ready to start" if mended else "not ready: an alarm is open")


def test_the_alarm_of_an_endpoint_that_is_not_open_outlasts_each_reset(tmp_path: Path) -> None:
    endpoint = Alarm(203, "the service goes on without OPC UA", where={ENDPOINT: "OPC UA"})
    with house(tmp_path) as built:
        built.parts.board.idle_alarm(endpoint)
        status = built.owner.status()
        assert (status.alarms, status.doing, "reset" in status.may) == ((endpoint,), "ready to start", False)
        built.owner.reset()
        assert built.owner.status().alarms == (endpoint,)
        lost = ended(built, tmp_path, RunState.FAULTED, LOST)  # an alarm of the run is shown alone
        assert lost.code == CODES[LinkLost].code
        built.owner.reset()
        assert built.owner.status().alarms == (endpoint,)
        still_open = [one.alarm for one in alarm_page(tmp_path, 10, 0).alarms if one.until is None]
        assert endpoint in still_open


def test_who_held_resumed_and_answered_is_in_the_journal(tmp_path: Path) -> None:
    with house(tmp_path) as built:
        run_id = built.owner.start(CALIBRATE)
        built.puppet.begun()
        journal_run(tmp_path, run_id, RunState.MEASURING)
        built.puppet.enter(RunState.MEASURING)
        built.owner.hold("Ann")
        built.puppet.enter(RunState.HELD)
        built.owner.resume()
        built.puppet.end(RunState.COMPLETE)
        assert built.owner.wait(600.0)
    with open_journal(tmp_path, JournalFailed) as reader:
        rows = reader.events(reader.require_run(run_id).run, ("request",))
    assert [row.record for row in rows] == [
        {"text": "hold requested", "request": "hold", "by": "Ann"},
        {"text": "resume requested", "request": "resume"},
    ]


def test_a_defect_keeps_its_number_though_the_run_could_not_journal_its_end(tmp_path) -> None:
    with house(tmp_path) as before:
        run_id = before.owner.start(CALIBRATE)
        before.puppet.begun()
        journal_run(tmp_path, run_id, RunState.MEASURING)
        before.puppet.crash(ZeroDivisionError("a defect"))
        assert before.owner.wait(600.0)
        (alarm,) = before.owner.status().alarms
        assert alarm.code == DEFECT.code
    with house(tmp_path) as after:
        assert after.owner.status().state is RunState.FAULTED
        assert after.owner.status().alarms == (alarm,)


@pytest.mark.parametrize(
    ("ends", "fault", "code"),
    [
        (RunState.FAULTED, LOST, 311),
        (RunState.FAULTED, MotionFault("limit of X"), 330),
        (RunState.ABORTED, None, 470),
        (RunState.FAULTED, RuntimeError("of a plugin"), 100),
        (RunState.MEASURING, None, 480),
    ],
)
def test_a_run_of_the_command_line_has_the_number_of_what_it_journaled(tmp_path, ends, fault, code) -> None:
    journal_run(tmp_path, "20261121T020000Z-0000", ends, fault)
    with house(tmp_path) as built:
        (alarm,) = built.owner.status().alarms
        assert alarm.code == code
        if fault is not None:
            assert str(fault) in alarm.text


def test_an_alarm_of_before_a_resumption_is_not_shown_for_a_later_end(tmp_path) -> None:
    with house(tmp_path) as before:
        ended(before, tmp_path, RunState.FAULTED, LOST)
        run_id = before.puppet.started[-1].run_id
    journal = Journal(tmp_path)
    try:
        number = 1
        record = journal.continue_run(number, run_id, VirtualClock())[0]
        record.state(RunState.MEASURING)
        record.fault(MotionFault("limit of X"))
        record.state(RunState.FAULTED, "limit of X", final=True)
    finally:
        journal.close()
    with house(tmp_path) as after:
        (alarm,) = after.owner.status().alarms
        assert (alarm.code, alarm.text) == (330, "limit of X")
