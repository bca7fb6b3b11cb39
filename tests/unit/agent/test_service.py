"""The parts of the service by themselves: who may begin at night, watchdog, events, token, questions, diagnostics."""

from __future__ import annotations

import dataclasses
import io
import json
import os
import signal
import socket
import threading
import time
import zipfile
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from queue import SimpleQueue

import pytest
from hypothesis import given
from hypothesis import strategies as st
from service_house import PATIENCE_S, READY_MACHINE, house, settings_document

from agent.cli.service_commands.start import DECLINED
from agent.errors import Aborted, Busy, GateRefused, ResetMissing
from agent.execution.journal import Journal
from agent.execution.run_state import Announcement
from agent.execution.states import RunState
from agent.execution.steps import Record, TouchTowards
from agent.execution.supervisor import Supervisor
from agent.planning.job import Job
from agent.runs.kinds.nightly import Night
from agent.runs.requested_run import job_of, kind_of
from agent.runs.run_request import RunRequest
from agent.service.client import error_of
from agent.service.control import Control
from agent.service.daemon.main_loop import MainLoop
from agent.service.daemon.sd_notify import Notifier
from agent.service.http.diagnostics import diagnostics_zip
from agent.service.http.problems import problem_of
from agent.service.owner.health import Health
from agent.service.owner.owner_parts import current_circumstances
from agent.service.owner.questions import Questions, ServiceOperator
from agent.service.owner.run_hooks import RunHooksFactory
from agent.service.owner.run_mailbox import RunMailbox
from agent.service.owner.unattended import Circumstances, minutes_until_end, require_warm
from agent.service.state.event_log import EventLog, new_event_log
from agent.service.state.status_board import doing
from agent.service.token import make_token, read_token, token_path
from agent.settings.listing import REMOVED, without_secrets
from agent.settings.schema import Settings
from agent.settings.service import ServiceSettings
from drivers.clock import VirtualClock
from drivers.errors import ConfigurationError, LinkLost, PermissionMissing, UserError, VolcalError
from drivers.roles import MachineStatus, MotionState, OperatorRequest, OperatorTask, Permission, Touch

NIGHTLY = RunRequest(kind="calibrate", source="timer")


def at(text: str, up_minutes: float = 600.0) -> Circumstances:
    return Circumstances(datetime.fromisoformat(f"2026-11-21T{text}:00"), up_minutes)


@pytest.mark.parametrize(
    ("now", "hours", "left"),
    [
        ("02:00", [], None),
        ("02:00", ["22:00-05:30"], 210.0),
        ("23:00", ["22:00-05:30"], 390.0),
        ("22:00", ["22:00-05:30"], 450.0),
        ("12:30", ["12:00-13:00", "12:15-14:00"], 90.0),
        ("09:00", ["00:00-00:00"], 900.0),
    ],
)
def test_the_hours_say_how_long_a_night_may_be(now, hours, left) -> None:
    assert minutes_until_end(at(now), hours) == left


@pytest.mark.parametrize("now", ["05:30", "12:00", "21:59"])
def test_outside_the_hours_nothing_begins_by_itself(now) -> None:
    with pytest.raises(GateRefused, match="22:00-05:30"):
        minutes_until_end(at(now), ["22:00-05:30"])


@given(st.integers(0, 1439), st.integers(0, 1439), st.integers(0, 1439))
def test_what_is_left_is_counted_minute_by_minute(begin, end, now) -> None:
    """Against a walk through the day, one minute at a time."""
    span = f"{begin // 60:02d}:{begin % 60:02d}-{end // 60:02d}:{end % 60:02d}"
    open_minutes = {(begin + n) % 1440 for n in range((end - begin) % 1440 or 1440)}
    circumstances = at(f"{now // 60:02d}:{now % 60:02d}")
    if now not in open_minutes:
        with pytest.raises(GateRefused):
            minutes_until_end(circumstances, [span])
        return
    walked = 0
    while ((now + walked) % 1440 in open_minutes and (now + walked) % 1440 != end) or walked == 0:
        walked += 1
    assert minutes_until_end(circumstances, [span]) == walked


@pytest.fixture
def berlin(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("TZ", "Europe/Berlin")
    time.tzset()
    yield
    monkeypatch.undo()
    time.tzset()


@pytest.mark.usefixtures("berlin")
@pytest.mark.parametrize(
    ("now", "fold", "hours", "left"),
    [
        ("2026-03-29T01:00", 0, "22:00-05:30", 210.0),  # the clock goes from 02:00 to 03:00
        ("2026-03-28T22:00", 0, "22:00-05:30", 390.0),
        ("2026-03-29T04:00", 0, "22:00-05:30", 90.0),
        ("2026-03-29T01:00", 0, "22:00-02:30", 30.0),  # the clock never shows 02:30
        ("2026-10-25T01:00", 0, "22:00-05:30", 330.0),  # the clock goes from 03:00 to 02:00
        ("2026-10-25T02:15", 0, "22:00-02:30", 15.0),
        ("2026-10-25T02:15", 1, "22:00-02:30", 15.0),
        ("2026-10-25T02:15", 1, "22:00-05:30", 195.0),
        ("2026-06-01T01:00", 0, "22:00-05:30", 270.0),
    ],
)
def test_the_hours_end_by_the_clock_also_in_a_night_in_which_it_is_changed(now, fold, hours, left) -> None:
    begin = datetime.fromisoformat(now).replace(fold=fold)
    assert minutes_until_end(Circumstances(begin, 600.0), [hours]) == left


@pytest.mark.usefixtures("berlin")
def test_the_service_knows_the_local_time_with_its_changes() -> None:
    """A time with a fixed difference from UTC would not know of the change."""
    assert current_circumstances().now.tzinfo is None


def test_a_machine_that_was_just_switched_on_is_left_alone() -> None:
    require_warm(at("02:00", 31.0), 30.0)
    with pytest.raises(GateRefused, match="has been on for 12 min"):
        require_warm(at("02:00", 12.0), 30.0)


def test_a_timer_is_refused_without_permission_and_the_next_night_is_not_lost(tmp_path: Path) -> None:
    doors_open = MachineStatus(MotionState.IDLE, {**READY_MACHINE.permissions, Permission.DOORS_CLOSED: False})
    with house(tmp_path, status=doors_open) as built, built.owner.subscribe() as events:
        with pytest.raises(PermissionMissing, match="doors closed"):
            built.owner.start(NIGHTLY)
        assert built.owner.status().state is RunState.IDLE
        assert built.puppet.started == []
        assert "was not started" in [events.get_nowait() for _ in range(events.qsize())][-1].text
        built.owner.start(RunRequest(kind="calibrate", source="page", consent=True))
        built.puppet.begun()


def test_who_asked_is_recorded_shown_and_forgotten_at_a_reset(tmp_path: Path) -> None:
    request = RunRequest(kind="calibrate", source="page", consent=True)
    with house(tmp_path) as built, built.owner.subscribe() as events:
        built.owner.start(request, "panel 2")
        built.puppet.begun()
        built.puppet.enter(RunState.MEASURING)
        built.owner.hold("panel 3")
        now = built.owner.status()
        assert (now.source, now.by) == ("page", "panel 2")
        assert built.puppet.started[-1].asked == {**request.model_dump(mode="json"), "by": "panel 2"}
        told = [events.get_nowait().text for _ in range(events.qsize())]
        assert "calibrate requested by page (panel 2)" in told
        assert "hold requested by panel 3" in told
        built.puppet.end(RunState.COMPLETE)
        assert built.owner.wait(PATIENCE_S)
        built.owner.reset("panel 2")
        assert (built.owner.status().source, built.owner.status().by) == ("", "")
        built.owner.start(request)
        built.puppet.begun()
        assert built.puppet.started[-1].asked == request.model_dump(mode="json")  # nobody is named


def test_the_controller_is_asked_again_after_a_run_that_broke_off(tmp_path: Path) -> None:
    with house(tmp_path) as built:
        asked = built.machine.asked
        built.owner.start(NIGHTLY)
        built.puppet.begun()
        assert asked == ["reached"]
        built.puppet.end(RunState.COMPLETE)
        assert built.owner.wait(PATIENCE_S)
        built.owner.reset()
        assert asked == ["reached"]
        built.owner.start(NIGHTLY)
        built.puppet.begun()
        built.puppet.end(RunState.FAULTED, LinkLost("gone"))
        assert built.owner.wait(PATIENCE_S)
        built.owner.reset()
        assert asked == ["reached", "reached"]


def test_a_machine_that_is_away_at_a_reset_is_asked_before_the_next_run(tmp_path: Path) -> None:
    with house(tmp_path) as built:
        devices = built.machine
        built.owner.start(NIGHTLY)
        built.puppet.begun()
        built.puppet.end(RunState.FAULTED, LinkLost("gone"))
        assert built.owner.wait(PATIENCE_S)
        devices.away.append(LinkLost("still gone"))
        built.owner.reset()
        assert built.owner.status().state is RunState.IDLE
        built.owner.start(NIGHTLY)
        built.puppet.begun()
        assert devices.asked == ["reached", "away", "reached"]


def test_the_station_of_a_night_is_where_the_artefact_stands_and_no_choice_of_what_is_measured(tmp_path: Path) -> None:
    settings = Settings.model_validate(settings_document(tmp_path))
    everywhere = job_of(RunRequest(kind="nightly", source="timer"), settings, tmp_path)
    at_the_second = RunRequest(kind="nightly", source="timer", stations=[2])
    assert job_of(at_the_second, settings, tmp_path).stations == everywhere.stations == (1, 2)
    kind = kind_of(at_the_second)
    assert isinstance(kind, Night)
    assert kind.station == 2
    calibration = RunRequest(kind="calibrate", source="page", stations=[2], consent=True)
    assert job_of(calibration, settings, tmp_path).stations == (2,)


def test_a_run_must_end_within_the_hours(tmp_path: Path) -> None:
    with house(tmp_path, circumstances=at("05:00"), service={"hours": ["22:00-05:30"]}) as built:
        built.owner.start(RunRequest(kind="nightly", source="timer", slot_minutes=45.0))
        built.puppet.begun()
        kind = built.puppet.started[0].kind
        assert isinstance(kind, Night)
        assert kind.slot_minutes == 30.0


def test_an_abort_before_the_run_has_its_mailbox_is_not_lost() -> None:
    running, supervisor = RunMailbox("a", lambda: None), Supervisor(VirtualClock())
    running.abort("at once")
    running.abort("later")
    running.attach(supervisor)
    with pytest.raises(Aborted, match="at once"):
        supervisor.check()


def test_the_end_of_the_service_holds_aborts_and_takes_no_more(tmp_path: Path) -> None:
    with house(tmp_path) as built:
        built.owner.start(NIGHTLY)
        built.puppet.begun()
        assert not built.owner.close(0.01)
        assert "being stopped" in str(built.puppet.abort_wanted)
        built.puppet.end(RunState.ABORTED)
        assert built.owner.close(PATIENCE_S)
        with pytest.raises(Busy, match="being stopped"):
            built.owner.start(NIGHTLY)


def test_settings_are_taken_between_runs_only(tmp_path: Path) -> None:
    with house(tmp_path) as built:
        other = Settings.model_validate(settings_document(tmp_path, nightly={"slot_minutes": 20.0}))
        built.owner.start(NIGHTLY)
        built.puppet.begun()
        with pytest.raises(Busy, match="in progress"):
            built.owner.reload(other)
        built.puppet.end(RunState.COMPLETE)
        assert built.owner.wait(PATIENCE_S)
        built.owner.reload(other)
        assert built.owner.settings.nightly.slot_minutes == 20.0
        with pytest.raises(UserError, match="state_directory"):
            built.owner.reload(Settings.model_validate(settings_document(tmp_path / "elsewhere")))


def test_a_run_that_is_asked_for_while_the_settings_are_reloaded_has_the_new_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = Settings.model_validate(settings_document(tmp_path, nightly={"slot_minutes": 20.0}))
    prepared: list[Settings] = []
    with house(tmp_path) as built:

        def preparing(request: RunRequest, settings: Settings, base: Path) -> Job:
            prepared.append(settings)
            job = job_of(request, settings, base)
            if settings is not other:
                built.owner.reload(other)
            return job

        monkeypatch.setattr("agent.service.owner.owner.job_of", preparing)
        built.owner.start(NIGHTLY)
        built.puppet.begun()
        assert (len(prepared), prepared[-1]) == (2, other)
        assert built.puppet.started[-1].job.settings.nightly.slot_minutes == 20.0


# ---------------------------------------------------------------------- requests to the run in progress


def test_a_hold_takes_a_resumption_back_while_the_run_is_still_held(tmp_path: Path) -> None:
    with house(tmp_path) as built:
        built.owner.start(NIGHTLY)
        built.puppet.begun()
        built.puppet.enter(RunState.MEASURING)
        built.owner.hold()
        built.puppet.enter(RunState.HELD)
        built.owner.resume()
        built.owner.hold()
        supervisor = built.puppet.supervisor
        assert supervisor is not None
        held: list[str] = []
        supervisor.on_hold = lambda: held.append("held")
        supervisor.before_resume = supervisor.request_resume
        built.puppet.clock.subscribe(lambda _: supervisor.request_resume())
        supervisor.check()
        assert held == ["held"]


def test_an_answered_question_is_shown_to_nobody_although_the_run_is_held(tmp_path: Path) -> None:
    with house(tmp_path) as built, built.event_log.subscribe() as events:
        questions = Questions(built.parts.board.show_question)
        number = questions.ask("carry it to station 2", 2).number
        assert "answer" in built.owner.status().may
        questions.answer(number, True)
        now = built.owner.status()
        assert (now.question, "answer" in now.may, questions.given_answer()) == (None, False, True)
        assert questions.close() is True
        told = [events.get_nowait() for _ in range(events.qsize())]
        assert [(event.text, event.data["open"]) for event in told] == [("carry it to station 2", True), ("yes", False)]


def test_an_answer_at_the_last_moment_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = VirtualClock()
    questions = Questions(lambda *_: None)
    look = questions.given_answer

    def looked() -> bool | None:
        found = look()
        if clock.now() >= 120.0 and questions.open is not None:  # after the run has looked for the last time
            questions.answer(1, True)
        return found

    monkeypatch.setattr(questions, "given_answer", looked)
    operator = ServiceOperator(questions, clock, 2.0, attended=True)
    assert operator.ask(OperatorRequest(OperatorTask.CONSENT, "?"))


# ---------------------------------------------------------------------- end of a run that fails in the service itself


def test_a_run_for_which_there_is_no_thread_ends_as_a_fault(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def start(_: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    with house(tmp_path) as built:
        with monkeypatch.context() as patched:
            patched.setattr(threading.Thread, "start", start)
            built.owner.start(NIGHTLY)
        now = built.owner.status()
        assert (built.owner.busy, now.state, len(now.alarms)) == (False, RunState.FAULTED, 1)


def test_an_outcome_that_cannot_be_shown_does_not_keep_the_machine(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def show(*_: object) -> None:
        raise ValueError("Out of range float values are not JSON compliant")

    with house(tmp_path) as built:
        monkeypatch.setattr(built.parts.board, "show_outcome", show)
        built.owner.start(NIGHTLY)
        built.puppet.begun()
        built.puppet.end(RunState.COMPLETE)
        assert built.owner.wait(PATIENCE_S)
        assert built.owner.status().state is RunState.FAULTED


# ---------------------------------------------------------------------- watchdog


def test_a_hang_is_seconds_where_something_moves_and_minutes_where_it_computes() -> None:
    clock = VirtualClock()
    health = Health(clock.now, hang_timeout_s=30.0, computing_s=900.0)
    clock.sleep(31.0)
    assert not health.alive(RunState.MEASURING)
    assert not health.alive(RunState.HELD)
    assert health.alive(RunState.PREFLIGHT)
    assert health.alive(RunState.IDLE)
    health.beat()
    assert health.alive(RunState.MEASURING)
    clock.sleep(901.0)
    assert not health.alive(RunState.IDENTIFYING)
    assert health.alive(RunState.FAULTED)


def test_a_resumed_run_is_given_minutes_until_its_machine_moves(tmp_path: Path) -> None:
    clock = VirtualClock()
    with house(tmp_path) as built:
        parts = dataclasses.replace(built.parts, health=Health(clock.now, hang_timeout_s=30.0, computing_s=900.0))
        factory, health = RunHooksFactory(parts, Questions(parts.board.show_question)), parts.health
        hooks = factory.hooks(RunMailbox("a", health.beat), built.owner.settings.clock, attended=True)
        for _ in range(2):  # the resumption, and a further one after a position was discarded
            hooks.announce(Announcement("state", "resuming", {"state": "resuming"}))
            assert parts.board.status().doing.endswith("nothing moves")
            clock.sleep(900.0)
            assert health.alive(RunState.RESUMING)
            clock.sleep(1.0)
            assert not health.alive(RunState.RESUMING)
            hooks.return_begins()
            assert parts.board.status().doing == "returning to where the run was interrupted"
            assert health.alive(RunState.RESUMING)
            clock.sleep(31.0)
            assert not health.alive(RunState.RESUMING)
        hooks.announce(Announcement("state", "measuring", {"state": "measuring"}))
        assert parts.board.status().doing == "measuring"
        assert health.alive(RunState.IDENTIFYING)


def test_a_run_that_has_ended_is_given_minutes_for_its_report(tmp_path: Path) -> None:
    clock = VirtualClock()
    with house(tmp_path) as built:
        parts = dataclasses.replace(built.parts, health=Health(clock.now, hang_timeout_s=30.0, computing_s=900.0))
        factory, health = RunHooksFactory(parts, Questions(parts.board.show_question)), parts.health
        hooks = factory.hooks(RunMailbox("a", health.beat), built.owner.settings.clock, attended=True)
        health.begin_run()
        for state in (RunState.VERIFYING, RunState.COMPLETE):
            clock.sleep(31.0)
            assert not health.alive(RunState.VERIFYING)
            hooks.announce(Announcement("state", state.value, {"state": state.value}))
            health.beat()
        clock.sleep(31.0)  # the doors are told VERIFYING until the machine is free again
        assert health.alive(RunState.VERIFYING)
        clock.sleep(900.0)
        assert not health.alive(RunState.VERIFYING)
        health.begin_run()
        clock.sleep(31.0)
        assert not health.alive(RunState.VERIFYING)


@pytest.mark.parametrize("abstract", [False, True])
def test_notifications_are_lines_of_one_datagram(tmp_path: Path, abstract: bool) -> None:
    name = f"@volcal-{os.getpid()}" if abstract else str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(f"\0{name[1:]}" if abstract else name)
        systemd.settimeout(PATIENCE_S)
        notifier = Notifier({"NOTIFY_SOCKET": name, "WATCHDOG_USEC": "3000000"})
        notifier.send(READY=1, STATUS="ready to start")
        assert systemd.recv(4096) == b"READY=1\nSTATUS=ready to start"
    assert notifier.watchdog_s == 3.0
    notifier.send(WATCHDOG=1)  # nobody listens any more: no reason to stop
    assert Notifier({"WATCHDOG_USEC": "3000000", "WATCHDOG_PID": "1"}).watchdog_s is None
    Notifier({}).send(READY=1)


class Told(Notifier):
    """Notifier that records its messages to systemd."""

    def __init__(self) -> None:
        super().__init__({"WATCHDOG_USEC": "3000000"})
        self.messages: list[dict[str, str | int]] = []

    def send(self, **assignments: str | int) -> None:
        self.messages.append(assignments)


@pytest.mark.parametrize("silent_s", [1.0, 31.0])
def test_a_service_whose_engine_hangs_is_no_longer_fed(
    tmp_path: Path, silent_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock, told = VirtualClock(), Told()
    signals: SimpleQueue[int] = SimpleQueue()
    health = Health(clock.now, hang_timeout_s=30.0, computing_s=900.0)
    clock.sleep(silent_s)
    signals.put(signal.SIGHUP)
    signals.put(signal.SIGTERM)
    with house(tmp_path) as built:
        built.owner.start(NIGHTLY)
        built.puppet.begun()
        built.puppet.enter(RunState.MEASURING)
        monkeypatch.setattr(built.owner, "close", lambda _: True)  # its own test is above
        MainLoop(built.owner, health, told, signals, tmp_path / "gone.toml").run()
    fed = [message for message in told.messages if "WATCHDOG" in message]
    assert bool(fed) is (silent_s < 30.0)
    assert told.messages[0]["READY"] == 1
    assert any("RELOADING" in message for message in told.messages)
    assert any("reloaded after the run" in str(message.get("STATUS")) for message in told.messages)
    assert any(str(message.get("STATUS")).startswith("the engine hangs") for message in told.messages) is not bool(fed)
    assert told.messages[-1]["STOPPING"] == 1


def test_after_a_power_cut_the_status_has_what_the_journal_holds_and_names_the_way_on(tmp_path: Path) -> None:
    journal = Journal(tmp_path)
    run = journal.start_run("run-1", "calibrate", {}, "0", VirtualClock())
    run.origin({})
    run.begun()
    touch = TouchTowards("touch", (1.0, 0.0, 0.0), 5.0)
    run.begin(touch)
    run.finish(touch, Touch((1.0, 0.0, 0.0)), begun=True)
    for ball in range(27):
        run.finish(Record(f"ball-{ball}", "ball", {"centre_mm": [0.0, 0.0, 0.0]}), None, begun=False)
    run.state(RunState.MEASURING)
    journal.close()
    with house(tmp_path) as built:
        left = built.owner.status()
        assert (left.state, left.run_id, left.balls, left.touches) == (RunState.FAULTED, "run-1", 27, 1)
        assert left.started is not None
        assert "`volcal resume` then resumes run run-1" in left.alarms[0].hint
        with pytest.raises(ResetMissing) as refused:
            built.owner.start(NIGHTLY)
        assert refused.value.exit_code != DECLINED
        assert type(error_of(problem_of(refused.value).model_dump())) is ResetMissing
        assert "reset (`volcal reset`), then resume run run-1 (`volcal resume`)" in refused.value.hint
        built.owner.reset()
        assert (built.owner.status().balls, built.owner.status().started) == (0, None)


class EndingEndpoint:
    """Endpoint that ends by itself when it is looked at for the second time."""

    name = "panel gateway"
    looks = 0

    def start(self, control: Control) -> None:
        raise AssertionError("the test opens no endpoint")

    def stop(self) -> None:
        raise AssertionError("the test closes no endpoint")

    @property
    def alive(self) -> bool:
        self.looks += 1
        return self.looks < 2


def test_an_endpoint_that_has_ended_stops_the_run_and_the_service(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told, closed = Told(), SimpleQueue[float]()

    def close(within_s: float) -> bool:
        closed.put(within_s)
        return True

    health = Health(VirtualClock().now, hang_timeout_s=30.0, computing_s=900.0)
    with house(tmp_path) as built:
        monkeypatch.setattr(built.owner, "close", close)
        loop = MainLoop(built.owner, health, told, SimpleQueue(), tmp_path / "volcal.toml", [EndingEndpoint()])
        with pytest.raises(LinkLost, match="panel gateway"):
            loop.run()
    assert closed.qsize() == 1
    assert told.messages[-1]["STOPPING"] == 1


BAD_SETTINGS = [
    "state_directory = 1" + "0" * 5000,
    "machine = " + "[" * 20_000,
    ".".join(["a"] * 30_000) + " = 1",
]


@pytest.mark.parametrize("text", BAD_SETTINGS)
def test_no_settings_file_ends_the_service(tmp_path: Path, text: str) -> None:
    config, told, signals = tmp_path / "volcal.toml", Told(), SimpleQueue[int]()
    config.write_text(text)
    signals.put(signal.SIGHUP)
    signals.put(signal.SIGTERM)
    with house(tmp_path) as built:
        before = built.owner.settings
        MainLoop(built.owner, built.parts.health, told, signals, config).run()
        assert built.owner.settings is before
    (said,) = [m["STATUS"] for m in told.messages if str(m.get("STATUS")).startswith("settings not reloaded")]
    assert "defect" not in str(said)


def test_settings_are_read_after_the_run_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told, signals = Told(), SimpleQueue[int]()
    loaded: list[Path] = []
    with house(tmp_path) as built:

        def load(config: Path) -> Settings:
            loaded.append(config)
            signals.put(signal.SIGTERM)
            assert not built.owner.busy
            return built.owner.settings

        monkeypatch.setattr("agent.service.daemon.main_loop.load_settings", load)
        built.owner.start(NIGHTLY)
        built.puppet.begun()
        signals.put(signal.SIGHUP)
        loop = MainLoop(built.owner, built.parts.health, told, signals, tmp_path / "volcal.toml")
        thread = threading.Thread(target=loop.run)
        thread.start()
        while not any("after the run" in str(message.get("STATUS")) for message in told.messages):
            thread.join(0.01)
        assert not loaded
        built.puppet.end(RunState.COMPLETE)
        thread.join(PATIENCE_S)
    assert len(loaded) == 1


def test_settings_that_were_read_while_a_run_began_are_read_again_after_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    signals = SimpleQueue[int]()
    changed = Settings.model_validate(settings_document(tmp_path, nightly={"slot_minutes": 20.0}))
    loaded: list[Path] = []
    with house(tmp_path) as built:

        class EndingTheRun(Told):
            """Ends the run once it is told that the settings wait for its end."""

            def send(self, **assignments: str | int) -> None:
                super().send(**assignments)
                status = str(assignments.get("STATUS"))
                if "after the run" in status or status.startswith("settings not reloaded"):
                    built.puppet.end(RunState.COMPLETE)
                if status.startswith("settings not reloaded"):
                    signals.put(signal.SIGTERM)

        def load(config: Path) -> Settings:
            loaded.append(config)
            if len(loaded) == 1:
                built.owner.start(NIGHTLY)
                built.puppet.begun()
            else:
                signals.put(signal.SIGTERM)
            return changed

        monkeypatch.setattr("agent.service.daemon.main_loop.load_settings", load)
        signals.put(signal.SIGHUP)
        MainLoop(built.owner, built.parts.health, EndingTheRun(), signals, tmp_path / "volcal.toml").run()
        assert (len(loaded), built.owner.settings.nightly.slot_minutes) == (2, 20.0)


def test_a_reload_names_the_changes_that_need_a_restart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told, signals = Told(), SimpleQueue[int]()
    service = {"port": 8600, "hours": ["22:00-05:00"]}
    mail = {"host": "mail.example", "sender": "mill@example.org", "to": ["meister@example.org"]}
    documents = [
        settings_document(tmp_path, service=service, notifications={"mail": mail}, gateway={"enabled": True}),
        settings_document(tmp_path, service={"hours": ["22:00-05:00"]}),
    ]
    with house(tmp_path) as built:
        monkeypatch.setattr(
            "agent.service.daemon.main_loop.load_settings", lambda _: Settings.model_validate(documents.pop(0))
        )
        for number in (signal.SIGHUP, signal.SIGHUP, signal.SIGTERM):
            signals.put(number)
        MainLoop(built.owner, built.parts.health, told, signals, tmp_path / "volcal.toml").run()
        assert built.owner.settings.service.hours == ["22:00-05:00"]
    part, whole = [m["STATUS"] for m in told.messages if m.get("READY")][1:]
    assert part == "settings reloaded, except those that need a restart: notifications, gateway, service.port"
    assert "restart" not in str(whole)


# ---------------------------------------------------------------------- events


def test_a_lagging_reader_loses_the_oldest_progress_first() -> None:
    event_log = EventLog(retained=3, queue_limit=4)
    with event_log.subscribe() as queue:
        for number in range(3):
            event_log.publish("progress", str(number))
        for name in ("state", "alarm", "note"):
            event_log.publish(name, name)
        assert [queue.get_nowait().text for _ in range(queue.qsize())] == ["2", "state", "alarm", "note"]
        for name in "abcde":
            event_log.publish("note", name)
        assert [queue.get_nowait().text for _ in range(queue.qsize())] == ["b", "c", "d", "e"]
    assert event_log.since(9) == (False, event_log.since(9)[1])
    assert [event.number for event in event_log.since(9)[1]] == [10, 11]
    lost, events = event_log.since(2)
    assert lost
    assert [event.number for event in events] == [9, 10, 11]
    assert event_log.since(500)[0]  # of another life of the service


def test_events_of_a_service_that_was_started_again_are_not_taken_for_those_of_before() -> None:
    former, later = (new_event_log(datetime(2026, 11, 21, 2, minute, tzinfo=UTC)) for minute in (0, 1))
    seen = [former.publish("note", "before") for _ in range(3)][-1].number
    events = [later.publish("note", "after") for _ in range(5)]
    lost, missed = later.since(seen)
    assert lost
    assert missed == tuple(events)


# ---------------------------------------------------------------------- questions


def test_a_question_without_an_answer_ends_and_closes() -> None:
    clock = VirtualClock()
    heard: list[object] = []
    questions = Questions(lambda question, text: heard.append((question is not None, text)))
    request = OperatorRequest(OperatorTask.MOVE_ARTEFACT, "carry it to station 2", 2)
    with pytest.raises(PermissionMissing, match="no answer within 2 min"):
        ServiceOperator(questions, clock, 2.0, attended=True).ask(request)
    assert 120.0 <= clock.now() < 121.0
    assert heard == [(True, "carry it to station 2"), (False, "not answered")]
    assert questions.open is None


def test_a_run_without_consent_asks_nobody() -> None:
    questions = Questions(lambda *_: pytest.fail("nobody is there"))
    with pytest.raises(PermissionMissing, match="no operator is present"):
        ServiceOperator(questions, VirtualClock(), 2.0, attended=False).ask(OperatorRequest(OperatorTask.CONSENT, "?"))


@pytest.mark.parametrize("yes", [True, False])
def test_the_first_answer_counts(yes: bool) -> None:
    clock = VirtualClock()
    questions = Questions(lambda *_: None)

    def answered(now: float) -> None:
        if now > 5.0 and questions.given_answer() is None:
            questions.answer(1, yes)
            with pytest.raises(UserError, match="already been answered"):
                questions.answer(1, not yes)

    clock.subscribe(answered)
    operator = ServiceOperator(questions, clock, 2.0, attended=True)
    assert operator.ask(OperatorRequest(OperatorTask.CONSENT, "?")) is yes


# ---------------------------------------------------------------------- secrets


def test_the_token_lies_in_a_file_of_its_owner(tmp_path: Path) -> None:
    settings = Settings.model_validate(settings_document(tmp_path))
    make_token(settings)
    path = token_path(settings, {})
    first = read_token(path)
    assert len(first) >= 32
    make_token(settings)
    assert read_token(path) == first
    path.chmod(0o640)
    with pytest.raises(ConfigurationError, match="can be read by others"):
        read_token(path)
    handed = tmp_path / "credentials"
    handed.mkdir()
    (handed / "token").write_text("of systemd, long enough")
    assert token_path(settings, {"CREDENTIALS_DIRECTORY": str(handed)}) == handed / "token"
    (tmp_path / "short").write_text("short")
    (tmp_path / "short").chmod(0o600)
    with pytest.raises(ConfigurationError, match="at least 16 are required"):
        read_token(tmp_path / "short")


def test_diagnostics_have_no_secrets(tmp_path: Path) -> None:
    document = settings_document(tmp_path)
    document["devices"]["twin"]["options"] = {"password": "hunter2", "host": "cnc", "deep": [{"api_key": "hunter2"}]}
    settings = Settings.model_validate(document)
    content = diagnostics_zip(settings, {"state": "idle"}, [])
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        texts = {name: archive.read(name) for name in archive.namelist()}
    assert not any(b"hunter2" in text for text in texts.values())
    assert b'"cnc"' in texts["settings.json"]
    assert json.loads(texts["status.json"]) == {"state": "idle"}
    assert without_secrets({"token_file": None, "user": "a"}) == {"token_file": None, "user": REMOVED}


def test_another_address_than_loopback_needs_a_certificate() -> None:
    assert ServiceSettings(host="::1").loopback
    with pytest.raises(ValueError, match="must not be sent unencrypted"):
        ServiceSettings(host="0.0.0.0")  # noqa: S104  it is refused
    with pytest.raises(ValueError, match="must be an IP address"):
        ServiceSettings(host="panel.plant")
    served = ServiceSettings(host="10.0.0.5", certificate_file=Path("c.pem"), key_file=Path("k.pem"))
    assert served.scheme == "https"
    assert served.resolved(Path("/etc/volcal")).key_file == Path("/etc/volcal/k.pem")


# ---------------------------------------------------------------------- words and errors


@pytest.mark.parametrize(
    ("host", "reached"),
    [("127.0.0.1", "127.0.0.1"), ("0.0.0.0", "127.0.0.1"), ("::", "[::1]"), ("10.1.2.3", "10.1.2.3")],  # noqa: S104
)
def test_every_address_is_reached_from_this_computer(host: str, reached: str) -> None:
    settings = ServiceSettings(host=host, certificate_file=Path("a.pem"), key_file=Path("a.key"))
    assert settings.reached_at == reached


def test_errors_come_through_the_door_as_they_were() -> None:
    for error in (Busy("run a is in progress", hint="wait"), LinkLost("gone", link="10.0.0.1"), VolcalError("x")):
        back = error_of(problem_of(error).model_dump())
        assert type(back) is type(error)
        assert str(back) == str(error)
    assert error_of({"title": "str", "detail": "odd"}).exit_code == 3


def test_what_it_is_doing_in_words() -> None:
    key = "measure/station-1/az0-el-45/ball-06/touch-2"
    assert doing(RunState.MEASURING, key, "verify") == "measuring: station 1, azimuth 0°, elevation -45°, ball 6"
    assert doing(RunState.MEASURING, "before/active-bank", "verify") == "measuring: preparing"
    check = "probe/station-2/az0-el45/ball-00/qualify/touch-3/above"
    place = "station 2, azimuth 0°, elevation 45°, ball 0"
    assert doing(RunState.MEASURING, check, "calibrate", "qualification") == f"qualifying the stylus: {place}"
    assert doing(RunState.MEASURING, key, "calibrate", "measuring").startswith("measuring: station 1")
    assert doing(RunState.STAGING, key, "calibrate") == "writing the new table into the inactive bank"
    assert all(doing(state, "", None) for state in RunState)
