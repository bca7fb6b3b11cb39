"""What the service tells: which events, in which words, once each, also after a restart."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import pytest
from journal_surgery import change_dates
from journaled import journaled
from service_house import PATIENCE_S, House, house
from test_alarm_after_restart import LOST, journal_run

from agent.errors import Busy, GateRefused
from agent.execution.journal import Journal
from agent.execution.states import RunState
from agent.notifications.notice import Notice
from agent.runs.reconcile_result import CompensationState, ReconcileAction, Reconciliation
from agent.runs.run_request import RunRequest
from agent.service.daemon import serve
from agent.service.state.archive import Archive
from agent.settings.notifications import NotificationSettings
from drivers.clock import VirtualClock
from drivers.errors import ConfigurationError, PermissionMissing, UserError, VolcalError

BY_HAND = RunRequest(kind="calibrate", source="page", consent=True)
BY_TIMER = RunRequest(kind="nightly", source="timer")
EVERYTHING = {"events": ["alarm", "end", "question", "not-started", "started"]}
MAIL = {"host": "127.0.0.1", "security": "none", "sender": "volcal@plant.example", "to": ["ann@plant.example"]}
MQTT = {"host": "127.0.0.1", "tls": False}
HOOK = {"url": "http://127.0.0.1:9/volcal"}


class Box:
    """Channel that takes everything."""

    def __init__(self) -> None:
        self.told: SimpleQueue[Notice] = SimpleQueue()

    def send(self, notice: Notice) -> str:
        self.told.put(notice)
        return ""

    def next(self) -> Notice:
        return self.told.get(timeout=PATIENCE_S)


@contextmanager
def telling(state: Path, monkeypatch: pytest.MonkeyPatch, built: House, **channels: Any) -> Iterator[dict[str, Box]]:
    """The notifications of the service, with a box in the place of each channel."""
    settings = NotificationSettings.model_validate({"page_url": "https://mill.example/", **channels})
    chosen = built.owner.settings.model_copy(update={"notifications": settings})
    boxes = {name: Box() for name in settings.channels}
    monkeypatch.setattr("agent.notifications.channels.open_channels", lambda _: boxes)
    monkeypatch.setattr("agent.service.daemon.notices.CLOSE_TIMEOUT_S", PATIENCE_S)  # everything is told before the end
    archive = Archive(state, built.parts.reports.path, lambda: built.owner.running_id)
    with serve.notifying(chosen, built.parts, built.owner, archive):
        yield boxes


def run(built: House, state: Path, ends: RunState, error: VolcalError | None) -> str:
    run_id = built.owner.start(BY_HAND)
    built.puppet.begun()
    journal_run(state, run_id, ends, error)
    built.puppet.enter(RunState.MEASURING)
    built.puppet.end(ends, error)
    assert built.owner.wait(PATIENCE_S)
    return run_id


def test_a_fault_is_told_once_with_number_cause_place_and_remedy(tmp_path, monkeypatch) -> None:
    with house(tmp_path) as built, telling(tmp_path, monkeypatch, built, mail=MAIL) as boxes:
        run_id = run(built, tmp_path, RunState.FAULTED, LOST)
        told = boxes["mail"].next()
    assert (told.occasion, told.severity, told.state) == ("end", "alarm", "faulted")
    assert told.subject == "case-study: Calibration: Fault"
    (alarm,) = told.alarms
    assert (alarm.code, alarm.text, alarm.hint) == (311, "no answer from 10.0.0.7", "plug it in")
    assert dict(alarm.where) == {"device": "cnc", "step": "station-1/ball-02"}
    assert told.run is not None
    assert (told.run.run_id, told.run.verdict) == (run_id, "faulted")
    assert told.run.report == f"https://mill.example/api/runs/{run_id}/report"
    for words in ("Alarm 311: Connection to a device lost", "Cause: no answer from 10.0.0.7", "Hint: plug it in"):
        assert words in told.text
    assert boxes["mail"].told.empty()


def test_in_german_it_is_german(tmp_path, monkeypatch) -> None:
    with house(tmp_path) as built, telling(tmp_path, monkeypatch, built, mail=MAIL, language="de") as boxes:
        run(built, tmp_path, RunState.FAULTED, LOST)
        told = boxes["mail"].next()
    assert told.subject == "case-study: Kalibrierung: Störung"
    assert told.text.startswith("Ein Fehler hat den Lauf beendet; keine Tabelle daraus wurde angenommen.\n")
    assert "Alarm 311: Verbindung zu einem Gerät unterbrochen" in told.text
    assert "Abhilfe: Kabel, Adresse und Stromversorgung prüfen; quittieren, dann Lauf fortsetzen." in told.text


def test_the_end_of_a_good_run_has_its_figures(tmp_path, monkeypatch) -> None:
    run_id = journaled(tmp_path, 3)
    for user in ("agent.notifications.dispatcher", "agent.service.daemon.notices"):
        monkeypatch.setattr(f"{user}.is_older", lambda *_: False)
    with house(tmp_path) as built, telling(tmp_path, monkeypatch, built, mail=MAIL, language="de") as boxes:
        told = boxes["mail"].next()
    assert (told.severity, told.subject) == ("info", "case-study: Kalibrierung: Angenommen")
    assert told.run is not None
    assert (told.run.run_id, told.run.verdict, told.run.ended) == (run_id, "accepted", "2026-11-04T03:30:00.000Z")
    assert told.at == told.run.ended
    for words in ("Maschinenzeit: 83,5 min", "VE ohne Tabelle: 10,00 µm", "3,50 µm vorher, 2,50 µm nachher"):
        assert words in told.text


def test_a_run_of_long_ago_is_not_told_when_notifications_begin(tmp_path, monkeypatch) -> None:
    journaled(tmp_path, 3)
    change_dates(tmp_path, "20261104T020000Z-0000", "2020-11-04T02:00:00.000Z", "2020-11-04T03:30:00.000Z")
    with house(tmp_path) as built, telling(tmp_path, monkeypatch, built, mail=MAIL) as boxes:
        pass
    assert boxes["mail"].told.empty()
    assert "dropped" not in " ".join(event.text for event in built.event_log.since(0)[1])


def test_an_end_that_was_told_is_not_told_again_after_a_restart(tmp_path, monkeypatch) -> None:
    with house(tmp_path) as built, telling(tmp_path, monkeypatch, built, mail=MAIL) as boxes:
        run(built, tmp_path, RunState.FAULTED, LOST)
        first = boxes["mail"].next()
    with house(tmp_path) as built, telling(tmp_path, monkeypatch, built, mail=MAIL) as boxes:
        assert built.owner.status().alarms[0].code == 311
    assert boxes["mail"].told.empty()
    with house(tmp_path) as built, telling(tmp_path, monkeypatch, built, mail=MAIL, webhook=HOOK) as boxes:
        built.owner.reset()
    assert boxes["webhook"].told.empty()
    assert first.notice_id.startswith("end-")


def test_an_end_that_the_service_could_not_tell_is_told_at_the_next_start(tmp_path, monkeypatch) -> None:
    with house(tmp_path) as built:
        run(built, tmp_path, RunState.FAULTED, LOST)  # nobody is told: as if the power had failed now
    with house(tmp_path) as built, telling(tmp_path, monkeypatch, built, mail=MAIL) as boxes:
        told = boxes["mail"].next()
    assert [alarm.code for alarm in told.alarms] == [311]


def test_a_run_whose_process_was_killed_is_told_as_interrupted(tmp_path, monkeypatch) -> None:
    journal_run(tmp_path, "20261121T020000Z-0000", RunState.MEASURING)
    with house(tmp_path) as built, telling(tmp_path, monkeypatch, built, mail=MAIL) as boxes:
        told = boxes["mail"].next()
    assert told.run is not None
    assert (told.run.verdict, told.severity) == ("unfinished", "warning")
    assert [alarm.code for alarm in told.alarms] == [480]


def test_each_end_of_a_resumed_run_is_told(tmp_path, monkeypatch) -> None:
    journal_run(tmp_path, "20261121T020000Z-0000", RunState.FAULTED, LOST)
    with house(tmp_path) as built, telling(tmp_path, monkeypatch, built, mail=MAIL) as boxes:
        first = boxes["mail"].next()
    journal = Journal(tmp_path)
    record = journal.continue_run(1, "20261121T020000Z-0000", VirtualClock())[0]
    record.state(RunState.MEASURING)
    record.state(RunState.FAULTED, "again", final=True)
    journal.close()
    with house(tmp_path) as built, telling(tmp_path, monkeypatch, built, mail=MAIL) as boxes:
        second = boxes["mail"].next()
    assert first.run is not None
    assert second.run is not None
    assert first.run.run_id == second.run.run_id
    assert first.notice_id != second.notice_id


def test_a_run_that_is_refused_before_the_journal_has_it_is_told(tmp_path, monkeypatch) -> None:
    with house(tmp_path) as built, telling(tmp_path, monkeypatch, built, mail=MAIL) as boxes:
        run_id = built.owner.start(BY_HAND)
        built.puppet.begun()
        built.puppet.crash(UserError("the position set has no position"))
        assert built.owner.wait(PATIENCE_S)
        told = boxes["mail"].next()
    assert told.run is not None
    assert (told.run.run_id, told.run.verdict, told.run.report) == (run_id, "refused", None)
    assert [alarm.code for alarm in told.alarms] == [200]


def test_the_name_of_a_file_that_is_no_utf_8_can_be_told(tmp_path, monkeypatch) -> None:
    with house(tmp_path) as built, telling(tmp_path, monkeypatch, built, mail=MAIL) as boxes:
        built.owner.start(BY_HAND)
        built.puppet.begun()
        built.puppet.crash(UserError("Fr\udce4se.toml cannot be read", hint="Fr\udce4se", file="Fr\udce4se.toml"))
        assert built.owner.wait(PATIENCE_S)
        told = boxes["mail"].next()
    assert dict(told.alarms[0].where)["file"] == "Fr\N{REPLACEMENT CHARACTER}se.toml"
    assert json.dumps(told.as_json(), ensure_ascii=False).encode()


def test_a_request_of_the_timer_that_is_not_carried_out_is_told(tmp_path, monkeypatch) -> None:
    hours: dict[str, Any] = {"service": {"hours": ["22:00-01:00"]}}
    with house(tmp_path, **hours) as built, telling(tmp_path, monkeypatch, built, mail=MAIL, language="de") as boxes:
        with pytest.raises(GateRefused):
            built.owner.start(BY_TIMER)
        with pytest.raises(GateRefused):
            built.owner.start(BY_HAND.model_copy(update={"consent": False}))  # somebody sees this on the page
        told = boxes["mail"].next()
    assert (told.occasion, told.severity) == ("not-started", "warning")
    assert told.subject == "case-study: Nachtlauf wurde nicht gestartet"
    assert "22:00-01:00" in told.text
    assert "Nachtlauf, angefordert von der Zeitschaltung, wurde nicht gestartet: Es ist 02:00" in told.text
    assert boxes["mail"].told.empty()


def test_a_request_of_the_timer_after_a_fault_that_nobody_has_reset_is_told(tmp_path, monkeypatch) -> None:
    with house(tmp_path) as built, telling(tmp_path, monkeypatch, built, mail=MAIL) as boxes:
        run(built, tmp_path, RunState.FAULTED, LOST)
        assert boxes["mail"].next().occasion == "end"
        for request in (BY_HAND, BY_TIMER):
            with pytest.raises(PermissionMissing):
                built.owner.start(request)
        told = boxes["mail"].next()
    assert told.subject == "case-study: Night run was not started"
    assert "remove the cause, reset" in told.text
    assert boxes["mail"].told.empty()


def test_a_request_of_the_timer_while_a_run_is_in_progress_is_told(tmp_path, monkeypatch) -> None:
    with house(tmp_path) as built, telling(tmp_path, monkeypatch, built, mail=MAIL) as boxes:
        run_id = built.owner.start(BY_HAND)
        with pytest.raises(Busy):
            built.owner.start(BY_TIMER)
        told = boxes["mail"].next()
        assert built.owner.running_id == run_id
        built.puppet.begun()
        built.puppet.end(RunState.COMPLETE)
        assert built.owner.wait(PATIENCE_S)
    assert (told.occasion, f"run {run_id} is in progress" in told.text) == ("not-started", True)


def test_an_alarm_between_runs_is_told_at_once(tmp_path, monkeypatch) -> None:
    with house(tmp_path) as built, telling(tmp_path, monkeypatch, built, mail=MAIL) as boxes:
        built.machine.found.append(
            Reconciliation(CompensationState.CHANGED, ReconcileAction.NOTHING, 2, instruction="look at the bank")
        )
        built.owner.reconcile_if_reached()
        told = boxes["mail"].next()
    assert (told.occasion, told.severity) == ("alarm", "alarm")
    assert told.subject == "case-study: alarm 360: Compensation table error"
    assert "Hint: look at the bank" in told.text


def test_each_channel_is_told_of_its_occasions_and_mqtt_of_each_state(tmp_path, monkeypatch) -> None:
    channels = {"mqtt": {**MQTT, **EVERYTHING}, "mail": {**MAIL, "events": ["alarm"]}, "webhook": {**HOOK}}
    with house(tmp_path) as built:
        with telling(tmp_path, monkeypatch, built, **channels) as boxes:
            run(built, tmp_path, RunState.FAULTED, LOST)
        told = [boxes["mqtt"].next() for _ in range(boxes["mqtt"].told.qsize())]
    assert [one.occasion for one in told if one.occasion != "state"] == ["started", "end"]
    states = [one for one in told if one.occasion == "state"]
    assert (states[-1].state, [alarm.code for alarm in states[-1].alarms]) == ("faulted", [311])
    assert boxes["webhook"].next().occasion == "end"
    assert boxes["webhook"].told.empty()
    assert boxes["mail"].told.empty()


def test_the_retained_state_has_the_alarms_that_are_open_between_runs(tmp_path, monkeypatch) -> None:
    lost = Reconciliation(CompensationState.CHANGED, ReconcileAction.NOTHING, 2, instruction="look at the bank")
    with house(tmp_path) as built:
        with telling(tmp_path, monkeypatch, built, mqtt=MQTT) as boxes:
            built.machine.found.append(lost)
            built.owner.reconcile_if_reached()
        opened = [boxes["mqtt"].next() for _ in range(boxes["mqtt"].told.qsize())][-1]
        with telling(tmp_path, monkeypatch, built, mqtt=MQTT) as boxes:
            built.owner.reset()
        closed = [boxes["mqtt"].next() for _ in range(boxes["mqtt"].told.qsize())][-1]
    assert (opened.occasion, opened.severity, [alarm.code for alarm in opened.alarms]) == ("state", "alarm", [360])
    assert (closed.occasion, closed.severity, closed.alarms) == ("state", "info", ())


def test_an_open_question_is_told(tmp_path, monkeypatch) -> None:
    with house(tmp_path) as built, telling(tmp_path, monkeypatch, built, mail=MAIL) as boxes:
        built.event_log.publish("question", "Carry the artefact to station 2", {"open": True, "number": 1})
        built.event_log.publish("question", "answered", {"open": False})
        told = boxes["mail"].next()
    assert told.subject == "case-study: a run waits for an answer"
    assert "Carry the artefact to station 2" in told.text
    assert boxes["mail"].told.empty()


def test_a_failing_receiver_is_shown_in_the_status(tmp_path, monkeypatch) -> None:
    with house(tmp_path) as built:
        assert built.owner.status().receivers == ()
        settings = NotificationSettings.model_validate({"webhook": {**HOOK, "url": "http://127.0.0.1:1/"}})
        chosen = built.owner.settings.model_copy(update={"notifications": settings})
        archive = Archive(tmp_path, built.parts.reports.path)
        with built.owner.subscribe() as events, serve.notifying(chosen, built.parts, built.owner, archive):
            run(built, tmp_path, RunState.FAULTED, LOST)
            while "webhook does not deliver" not in events.get(timeout=PATIENCE_S).text:
                pass
        (shown,) = built.owner.status().receivers
    assert (shown.channel, shown.waiting) == ("webhook", 1)
    assert "cannot be reached" in shown.problem


def test_a_bad_secret_is_found_when_the_service_starts(tmp_path) -> None:
    with house(tmp_path) as built:
        settings = NotificationSettings.model_validate({"webhook": {**HOOK, "key_file": tmp_path / "none"}})
        chosen = built.owner.settings.model_copy(update={"notifications": settings})
        archive = Archive(tmp_path, built.parts.reports.path)
        with (
            pytest.raises(ConfigurationError, match="no such file"),
            serve.notifying(chosen, built.parts, built.owner, archive),
        ):
            pass
