"""Notices about the events of the service: what is told of an alarm, the end of a run, an open question or a refused
request of the timer."""

from __future__ import annotations

import json
import threading
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import datetime
from functools import partial
from importlib.resources import files
from queue import Queue
from typing import Any

import structlog

from agent.execution.states import RunState
from agent.language.sentences import Language, in_language
from agent.notifications.dispatcher import Dispatcher
from agent.notifications.notice import Notice, NoticeAlarm, NoticeRun, Occasion, Severity
from agent.notifications.outbox import is_older
from agent.notifications.wording import facts, kind_word, word
from agent.printable import one_line, printable
from agent.results.run_verdict import FAULTED, UNFINISHED, VERDICTS, Look, RunVerdict
from agent.service.allowed_requests import AT_REST
from agent.service.control import Alarm, Event, Status
from agent.settings.notifications import NotificationSettings
from drivers.clock import utc_timestamp
from drivers.errors import VolcalError

log = structlog.get_logger()

Summary = Mapping[str, Any]
_SEVERITY: dict[Look, Severity] = {Look.BAD: "alarm", Look.REFUSED: "warning", Look.WAITING: "warning"}
_LONGEST = 500
_LAST = Event(0, "closed", "", {})
"""Event that ends the watch; the event log never publishes it."""
CLOSE_TIMEOUT_S = 3.0
"""Longest time in s that the service waits for notices when it stops, and again for their delivery; those that wait
longer are delivered after the next start."""


@dataclass(frozen=True)
class ConcludedRun:
    """Summary of a run as `/api/runs` gives it, with the number of its last change of state, which tells two ends of a
    run that was resumed apart."""

    summary: Summary
    number: int


@dataclass
class NoticeMaker:
    """Maker of the notices of one service, from its events.

    `status` returns the status of the service, and `ended` the run of an identity, or None if the journal does not
    have it.
    """

    settings: NotificationSettings
    status: Callable[[], Status]
    ended: Callable[[str], ConcludedRun | None]
    now: Callable[[], str] = utc_timestamp
    _state: RunState = field(init=False)
    _alarms: list[Alarm] = field(init=False, default_factory=list)

    def __post_init__(self) -> None:
        self._state = self.status().state
        self._messages: Mapping[str, Mapping[str, str]] = json.loads(
            (files("agent.service.page") / "assets" / "messages.json").read_text(encoding="utf-8")
        )

    def on_event(self, event: Event) -> tuple[Notice, ...]:
        """Return the notices of an event. The alarm with which a run ends is part of the notice of its end."""
        match event.kind:
            case "alarm":
                return self._on_alarm(event)
            case "state":
                return (*self._on_state(event), self.state_notice())
            case "question" if event.data.get("open"):
                return (self._notice("question", "warning", opening=event.text),)
            case "note" if "found" in event.data:  # a comparison of the compensation, which may close an alarm
                return (self.state_notice(),)
            case "note" if event.data.get("source") == "timer" and event.data.get("not_started"):
                kind = kind_word(str(event.data["not_started"]), self._language)
                opening = ". ".join(part for part in (event.text, str(event.data.get("hint", ""))) if part)
                return (self._notice("not-started", "warning", opening=opening, kind=kind),)
        return ()

    def found_at_start(self, last: ConcludedRun | None) -> tuple[Notice, ...]:
        """Return the notice of the last run, in case the service ended before it was told, and the present state.

        The id of a run's end is the same each time, so the outbox drops the notice if it has been told.
        """
        status = self.status()
        if last is None or not _has_ended(last, status):
            return (self.state_notice(),)
        told = self._end(last, status.state, status.alarms)
        if is_older(told, self.settings.max_age_hours, datetime.fromisoformat(self.now())):
            return (self.state_notice(),)
        return (told, self.state_notice())

    def state_notice(self) -> Notice:
        """Return the present state of the service, for receivers that retain it."""
        status = self.status()
        notice = self._notice("state", "alarm" if status.alarms else "info", alarms=status.alarms, opening=status.doing)
        return replace(notice, state=status.state.value)

    @property
    def _language(self) -> Language:
        return self.settings.language

    def _on_alarm(self, event: Event) -> tuple[Notice, ...]:
        data = event.data
        alarm = Alarm(data["code"], event.text, data["hint"], data["where"])
        if self._state not in AT_REST:
            self._alarms.append(alarm)
            return ()
        return (self._notice("alarm", "alarm", alarms=(alarm,)), self.state_notice())

    def _on_state(self, event: Event) -> tuple[Notice, ...]:
        former, self._state = self._state, RunState(event.data["state"])
        alarms, self._alarms = tuple(self._alarms), self._alarms if self._state not in AT_REST else []
        run_id, kind = event.data.get("run_id"), str(event.data.get("kind") or "")
        if former in AT_REST and self._state not in AT_REST:
            run = NoticeRun(run_id or "", kind, started=self.now())
            return (self._notice("started", "info", run=run, kind=kind_word(kind, self._language)),)
        if former in AT_REST or self._state not in AT_REST or run_id is None:
            return ()
        found = self.ended(run_id) or ConcludedRun({"run_id": run_id, "kind": kind}, 0)
        return (self._end(found, self._state, alarms),)

    def _end(self, ended: ConcludedRun, state: RunState, alarms: tuple[Alarm, ...]) -> Notice:
        summary = ended.summary
        verdict = _verdict(summary, state)
        run = NoticeRun(
            run_id=summary["run_id"],
            kind=summary["kind"],
            verdict=verdict.name,
            verdict_text=verdict.sentence[self._language],
            report=self._report(summary),
            **{name: summary.get(name) for name in _FIGURES},
        )
        notice = self._notice(
            "end",
            _SEVERITY.get(verdict.look, "info"),
            alarms=alarms,
            run=run,
            opening=verdict.sentence[self._language],
            kind=kind_word(run.kind, self._language),
            verdict=verdict.word[self._language],
        )
        notice_id = f"end-{run.run_id}-{ended.number}"
        return replace(notice, notice_id=notice_id, state=state.value, at=run.ended or notice.at)

    def _report(self, summary: Summary) -> str | None:
        base = self.settings.page_url
        if base is None or summary.get("ended") is None:
            return None
        return f"{base.rstrip('/')}/api/runs/{summary['run_id']}/report"

    def _notice(
        self,
        occasion: Occasion,
        severity: Severity,
        *,
        alarms: tuple[Alarm, ...] = (),
        run: NoticeRun | None = None,
        opening: str = "",
        **values: str,
    ) -> Notice:
        opening = in_language(opening, self._language)
        machine, shown = self.status().machine, tuple(self._shown(alarm) for alarm in alarms)
        if occasion == "alarm":
            values |= {"code": str(shown[0].code), "meaning": shown[0].meaning}
        subject = opening if occasion == "state" else word(occasion, self._language, **values)
        return Notice(
            notice_id=str(uuid.uuid4()),
            at=self.now(),
            machine=machine,
            occasion=occasion,
            severity=severity,
            state=self._state.value,
            subject=one_line(f"{machine}: {subject}", _LONGEST),
            text=printable(facts(machine, self._language, shown, run, opening)),
            alarms=shown,
            run=run,
        )

    def _shown(self, alarm: Alarm) -> NoticeAlarm:
        meaning = self._messages.get(f"alarm.{alarm.code}", {}).get(self._language, alarm.text)
        remedy = self._messages.get(f"alarm.{alarm.code}.do", {}).get(self._language, alarm.hint)
        where = {name: printable(place) for name, place in alarm.where.items()}  # names of files may be no UTF-8
        text, hint = (printable(in_language(words, self._language)) for words in (alarm.text, alarm.hint))
        return NoticeAlarm(alarm.code, meaning, remedy, text, hint, where)


_FIGURES = (
    *("started", "ended", "machine_minutes"),
    *("ve_um", "vce_um", "held_out_before_um", "held_out_after_um"),
)


def _verdict(summary: Summary, state: RunState) -> RunVerdict:
    """Return the verdict on a run that has ended, by its name in the summary; without one the state decides."""
    if summary.get("ended") is None and state is RunState.FAULTED:
        return UNFINISHED if "verdict" in summary else FAULTED
    name = summary.get("verdict", {}).get("name", state.value)
    return next((one for one in VERDICTS if one.name == name), FAULTED)


def _has_ended(last: ConcludedRun, status: Status) -> bool:
    """Return True if the run has its end, or if the service shows it as one that was interrupted."""
    return last.summary["ended"] is not None or last.summary["run_id"] == status.run_id


class NoticeWatch:
    """Thread that makes notices of the events of the service and puts them into the outbox."""

    def __init__(self, maker: NoticeMaker, dispatcher: Dispatcher) -> None:
        self._maker = maker
        self._dispatcher = dispatcher

    @contextmanager
    def watching(self, events: Queue[Event], last: ConcludedRun | None) -> Iterator[None]:
        """Watch the queue `events` for the duration of the `with` block, and to its end when the block ends. `last` is
        the last run of the journal."""
        thread = threading.Thread(target=self._work, args=(events, last), name="notices", daemon=True)
        thread.start()
        try:
            yield
        finally:
            events.put(_LAST)
            thread.join(CLOSE_TIMEOUT_S)

    def _work(self, events: Queue[Event], last: ConcludedRun | None) -> None:
        self._put(partial(self._maker.found_at_start, last))
        while (event := events.get()) is not _LAST:
            self._put(partial(self._maker.on_event, event))

    def _put(self, make: Callable[[], tuple[Notice, ...]]) -> None:
        try:
            for notice in make():
                channels = channels_of(notice.occasion, self._maker.settings)
                self._dispatcher.put(notice, channels, replaces=notice.occasion == "state")
        except VolcalError as error:
            log.warning("an event was not told", reason=str(error))
        except Exception:  # a defect here must end neither the notices nor the service
            log.exception("defect in a notice")


def channels_of(occasion: Occasion, settings: NotificationSettings) -> tuple[str, ...]:
    """Return the channels that are told of this occasion. Only MQTT has a retained state."""
    if occasion == "state":
        return ("mqtt",) if settings.mqtt is not None else ()
    return tuple(name for name, channel in settings.channels.items() if occasion in channel.events)
