"""All traffic with a GRBL controller: lines sent, their answers, and other lines received.

There is no receiving thread. The controller answers a status query at any time, and its lines arrive in the order in
which it sent them. After the answer to a query has been read, all earlier lines have therefore been read too. Every
wait in this module is for an immediate answer and is bounded in the time of the link (wall time on a serial port).
Callers make longer waits on the clock.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from drivers.errors import CommandRejected, DeviceError, LinkLost, LinkTimeout, ProtocolError
from drivers.links.serial_port import LineLink
from drivers.serial_cnc.codes import LOCKED_ERRORS, error_text
from drivers.serial_cnc.lines import (
    AlarmLine,
    AnswerLine,
    GarbledLineError,
    Line,
    MessageLine,
    ProbeResult,
    SettingLine,
    StatusReport,
    WelcomeLine,
    parse_line,
)
from drivers.serial_cnc.settings import SerialCncSettings

QUERY, HOLD, RESUME, SOFT_RESET, CANCEL_JOG = b"?", b"!", b"~", b"\x18", b"\x85"
"""Real-time characters, which the controller executes at once, outside the stream of lines.

They have no line end, and none is acknowledged by ``ok``.
"""

SYNCHRONISE = "="
"""Invalid line, which the controller refuses without doing anything.

If a previous user has sent part of a line, this completes that part to an invalid line.
"""
# A board that resets when the port is opened loses the queries that come during its boot.
BOOT_QUERY_EVERY_S = 0.25
LATE_WITHIN_S = 0.02


@dataclass
class SentLine:
    """Line that was sent to the controller, and its answer. The answer is None until it arrives."""

    line: str
    answer: AnswerLine | None = None

    @property
    def answered(self) -> bool:
        return self.answer is not None


class Conversation:
    """Conversation with one controller over its serial line.

    Methods raise LinkLost, LinkTimeout or ProtocolError. Each error names the device and the link.
    """

    def __init__(self, line: LineLink, settings: SerialCncSettings) -> None:
        self.line = line
        self._seconds = line.seconds
        self.settings = settings
        self.where = line.where
        self._look_only = False
        self._pending: deque[SentLine] = deque()
        self._orphans = 0
        """Number of lines sent before a restart that the controller may receive and answer only after it."""
        self._synchronised = False
        self._reports = 0
        self._last_report: StatusReport | None = None
        self._unanswered: deque[float] = deque()
        """Instants at which the status queries were sent whose reports may still come, oldest first."""
        self._messages: list[MessageLine | SettingLine] = []
        self.restarts = 0
        self.alarm: int | None = None
        self.probe_results: list[ProbeResult] = []

    # ------------------------------------------------------------------ open

    def open(self, *, look_only: bool = False) -> StatusReport:
        """Connect and wait for the first status report. Call `synchronise` before sending lines. Moves nothing.

        If `look_only` is True, nothing but status queries is sent until the line is closed.
        """
        self._connect()
        self._look_only = look_only
        return self._first_report()

    def _connect(self, *, shared: bool = False) -> None:
        self.line.open(shared=shared)
        self._pending.clear()
        self._messages.clear()
        self._unanswered.clear()
        self._synchronised = False
        self.probe_results.clear()

    def close(self) -> None:
        self._look_only = False
        self.line.close()

    def _write(self, data: bytes) -> None:
        self._require_allowed(data)
        self.line.write(data)

    def _require_allowed(self, data: bytes) -> None:
        if self._look_only and data != QUERY:
            raise CommandRejected(
                "refused to send over a line that was opened only to read",
                hint="close the device and open it for a run",
                **self.where,
            )

    def _first_report(self) -> StatusReport:
        deadline_s = self._seconds() + self.settings.boot_timeout_s
        before, garbled = self._reports, ""
        while True:
            self._query()
            try:
                self._read_for(BOOT_QUERY_EVERY_S, before)
            except ProtocolError as error:
                garbled = error.message  # a booting board may send any text
            if self._reports > before and self._last_report is not None:
                return self._last_report
            if self._seconds() >= deadline_s:
                break
        if garbled:
            raise ProtocolError(
                f"this is not a GRBL controller: {garbled}", hint="check baud and the connected device", **self.where
            )
        raise LinkTimeout(
            f"no status report within {self.settings.boot_timeout_s:g} s",
            hint="check port and baud, and that the controller is on",
            **self.where,
        )

    def synchronise(self) -> None:
        """Discard late answers to lines that a previous user sent. The controller must be idle or locked.

        The method sends an invalid line, which the controller refuses. All answers up to and including the refusal are
        discarded.
        """
        self._write(SYNCHRONISE.encode() + b"\n")
        deadline_s = self._seconds() + self.settings.response_timeout_s
        while self._seconds() < deadline_s:
            line = self._next_line_or_raw(deadline_s - self._seconds())
            if isinstance(line, AnswerLine) and line.error is not None:
                while self._next_line_or_raw(LATE_WITHIN_S) is not None:
                    continue
                self._synchronised = True
                self._acknowledge()
                return
        raise LinkTimeout(
            "the controller reports its status but does not answer lines",
            hint="check for a motion started by another program; reset the controller",
            **self.where,
        )

    def _next_line_or_raw(self, within_s: float) -> Line | bytes | None:
        """Return the next line, parsed, or its bytes if it is garbled, such as the end of an earlier line.

        Returns None if no line arrives within `within_s` of wall time.
        """
        raw = self.line.read_line(within_s)
        if raw is None:
            return None
        try:
            return self._record(parse_line(raw))
        except GarbledLineError:
            return raw

    # ------------------------------------------------------------------ requests

    def report(self) -> StatusReport:
        """Query the status and return a report that the controller has made after this call began.

        A query has no side effect, so the query is repeated if its answer is lost, late or garbled. Reports do not say
        which query they answer. Those of an earlier call that may still come are therefore awaited first.
        """
        self._await_late_reports()
        last: ProtocolError | None = None
        for _ in range(self.settings.retries + 1):
            before = self._reports
            self._query()
            try:
                self._read_for(self.settings.response_timeout_s / (self.settings.retries + 1), before)
            except ProtocolError as error:
                if "garbled" not in error.where:
                    raise
                last = error
                self._discount(error)
            if self._reports > before and self._last_report is not None:
                return self._last_report
        if last is not None:
            raise last
        raise LinkTimeout(
            f"no status report within {self.settings.response_timeout_s:g} s",
            hint="check whether the controller is off, hangs, or is homing",
            **self.where,
        )

    def _query(self) -> None:
        self._write(QUERY)
        self._unanswered.append(self._seconds())

    def _await_late_reports(self) -> None:
        """Read the reports of earlier queries, each for at most `response_timeout_s` after its query.

        A report that has not come by then was lost, or the controller has answered two queries by one report.
        """
        while self._unanswered:
            # the latest query: reports come in order, so after its time no earlier one is due either
            deadline_s = self._unanswered[-1] + self.settings.response_timeout_s
            try:
                if self._seconds() >= deadline_s or not self._read_one(deadline_s):
                    self._unanswered.clear()
            except ProtocolError as error:
                if "garbled" not in error.where:
                    raise
                self._discount(error)

    def _discount(self, error: ProtocolError) -> None:
        """Count a garbled line as the answer to a query if it looks like a part of a report."""
        if self._unanswered and any(mark in error.where["garbled"] for mark in "<|>"):
            self._unanswered.popleft()

    def send(self, line: str) -> SentLine:
        """Send a line without waiting for its answer. If the controller's receive buffer is full, first wait until it
        has room.
        """
        sent = SentLine(line)
        deadline_s = self._seconds() + self.settings.response_timeout_s
        # Character counting, as GRBL documents it: lines without an answer still occupy the controller's receive
        # buffer, whose overflow loses characters without notice.
        while self._pending and self._buffered(line) >= self.settings.receive_buffer:
            if not self._read_one(deadline_s):
                raise LinkTimeout("the controller accepts no further line: its buffer is full", **self.where)
        self._pending.append(sent)
        self._orphans = 0
        self._write(line.encode("ascii") + b"\n")
        return sent

    def ask(self, line: str) -> list[MessageLine | SettingLine]:
        """Send a line that is answered at once, and return the lines received before its ``ok``.

        Raises CommandRejected if the answer is an ``error``.
        """
        self._messages.clear()
        sent = self.send(line)
        self.await_answer(sent)
        self.require_accepted(sent)
        return list(self._messages)

    def await_answer(self, sent: SentLine) -> None:
        deadline_s = self._seconds() + self.settings.response_timeout_s
        restarts = self.restarts
        while not sent.answered:
            if self.restarts != restarts:
                raise ProtocolError(f"the controller has restarted instead of answering {sent.line!r}", **self.where)
            if not self._read_one(deadline_s):
                raise LinkTimeout(
                    f"no answer to {sent.line!r} within {self.settings.response_timeout_s:g} s", **self.where
                )

    def require_accepted(self, sent: SentLine) -> None:
        error = sent.answer.error if sent.answer is not None else None
        if error is None:
            return
        hint = "clear the alarm: home the machine, or $X if its position is certain" if error in LOCKED_ERRORS else ""
        rejected = CommandRejected(
            f"the controller refused {sent.line!r}: {error_text(error)}", hint=hint, error=error, **self.where
        )
        try:
            self._acknowledge()
        except DeviceError as failure:
            rejected.add_note(f"the error could not be acknowledged: {failure}")
        raise rejected

    def _acknowledge(self) -> None:
        """Send an empty line, which acknowledges an error.

        Until then grblHAL answers every further block with the same error and does not execute it. To GRBL 1.1 an empty
        line means nothing.
        """
        self.await_answer(self.send(""))

    def realtime(self, character: bytes) -> None:
        self._write(character)

    def urgent(self, characters: bytes) -> None:
        """Send real-time characters ahead of all unsent data: on the present connection, else on a new one.

        The new connection is opened even if another program uses the port. Raises LinkLost or LinkTimeout if neither
        accepts them. This takes less than a second of wall time.
        """
        self._require_allowed(characters)
        if self.line.connected:
            try:
                self.line.write_urgent(characters)
            except (LinkLost, LinkTimeout):
                self.line.close()
            else:
                return
        self._connect(shared=True)
        self.line.write_urgent(characters)

    def reset(self) -> None:
        """Send a soft reset and wait for the welcome line.

        Lines that are still unanswered are discarded, because no answer will come.
        """
        restarts = self.restarts
        self.alarm = None
        self._write(SOFT_RESET)
        deadline_s = self._seconds() + self.settings.response_timeout_s
        while self.restarts == restarts:
            if not self._read_one(deadline_s):
                raise LinkTimeout(
                    "no welcome line after a soft reset", hint="reset the controller by hand", **self.where
                )
        self._synchronised = True  # it has forgotten all lines

    def clear_alarm(self) -> None:
        """Clear the alarm stored in this object. Call it after a status report that shows no alarm state."""
        self.alarm = None

    def drain_for(self, wall_s: float) -> None:
        """Wait up to `wall_s` seconds of wall time for a line. If a line arrives, process it and return."""
        self._read_one(self._seconds() + wall_s)

    # ------------------------------------------------------------------ receiving

    def _buffered(self, line: str) -> int:
        return sum(len(sent.line) + 1 for sent in self._pending) + len(line) + 1

    def _read_for(self, wall_s: float, reports: int) -> None:
        deadline_s = self._seconds() + wall_s
        while self._reports == reports and self._read_one(deadline_s):
            continue

    def _read_one(self, deadline_s: float) -> bool:
        """Receive and process one line; return False if none arrives before `deadline_s` (wall clock)."""
        raw = self.line.read_line(deadline_s - self._seconds())
        if raw is None:
            return False
        try:
            line = parse_line(raw)
        except GarbledLineError as error:
            raise ProtocolError(
                f"garbled line from the controller: {error}",
                hint="check cable, shield and baud",
                garbled=repr(raw[:80]),
                **self.where,
            ) from error
        self._record(line)
        if isinstance(line, AnswerLine):
            self._answer(line)
        return True

    def _record(self, line: Line) -> Line:
        match line:
            case StatusReport():
                self._reports, self._last_report = self._reports + 1, line
                if self._unanswered:
                    self._unanswered.popleft()
            case AlarmLine(code):
                self.alarm = code
            case ProbeResult():
                self.probe_results.append(line)
            case WelcomeLine():
                self.restarts += 1
                # The controller may have received lines just before it restarted, and answer them afterwards.
                self._orphans = len(self._pending)
                self._pending.clear()
                self._unanswered.clear()
            case MessageLine() | SettingLine():
                self._messages.append(line)
            case _:
                pass
        return line

    def _answer(self, answer: AnswerLine) -> None:
        if not self._pending:
            if not self._synchronised:
                return  # answer to a line of a previous user
            if self._orphans:
                self._orphans -= 1
                return
            text = "ok" if answer.error is None else f"error:{answer.error}"
            raise ProtocolError(
                f"{text!r} from the controller, but no line waits for an answer",
                hint="an answer came twice, or another program uses this line",
                **self.where,
            )
        self._pending.popleft().answer = answer
