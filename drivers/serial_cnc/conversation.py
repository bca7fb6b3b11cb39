"""Everything that is said over the line passes here: what waits for an answer, and what the controller has told.

There is no thread: the controller answers a status query at any time and in its order, so whoever asks one has also
read everything that came before it. Waiting is the caller's, on the clock; here every wait is for an answer that
comes at once, and bounded in wall time.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from drivers.clock import wall_seconds
from drivers.errors import CommandRejected, LinkTimeout, ProtocolError
from drivers.links.serial_port import SerialPort
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
"""Real-time characters: not part of the stream, no end of line, no answer of their own."""

SYNCHRONISE = "="
"""No controller knows such a line: it is refused, does nothing, and spoils what an earlier user has left half-sent."""
BOOT_QUERY_EVERY_S = 0.25
LATE_WITHIN_S = 0.02


@dataclass
class SentLine:
    """A line that was sent, and its answer once it has come."""

    line: str
    answer: AnswerLine | None = None

    @property
    def answered(self) -> bool:
        return self.answer is not None


class Conversation:
    """Raises LinkLost, LinkTimeout and ProtocolError, each naming device and link."""

    def __init__(self, line: SerialPort, settings: SerialCncSettings) -> None:
        self.line = line
        self.settings = settings
        self.where = line.where
        self._pending: deque[SentLine] = deque()
        self._synchronised = False
        self._reports = 0
        self._last_report: StatusReport | None = None
        self._messages: list[MessageLine | SettingLine] = []
        self.restarts = 0
        self.alarm: int | None = None
        self.probe_results: list[ProbeResult] = []

    # ------------------------------------------------------------------ open

    def open(self) -> StatusReport:
        """Connect and wait for a first report. Before anything is asked, `synchronise`. Moves nothing."""
        self.line.open()
        self._pending.clear()
        self._messages.clear()
        self._synchronised = False
        self.probe_results.clear()
        return self._first_report()

    def close(self) -> None:
        self.line.close()

    def _first_report(self) -> StatusReport:
        deadline_s = wall_seconds() + self.settings.boot_within_s
        before, garbled = self._reports, ""
        while True:
            self.line.write(QUERY)
            try:
                self._read_for(BOOT_QUERY_EVERY_S, before)
            except ProtocolError as error:
                garbled = error.message  # a board that boots says all sorts of things
            if self._reports > before and self._last_report is not None:
                return self._last_report
            if wall_seconds() >= deadline_s:
                break
        if garbled:
            raise ProtocolError(
                f"this does not talk like a GRBL: {garbled}", hint="check baud and what is connected", **self.where
            )
        raise LinkTimeout(
            f"no status report within {self.settings.boot_within_s:g} s",
            hint="check port and baud, and that the controller is on",
            **self.where,
        )

    def synchronise(self) -> None:
        """Agree on which answer belongs to which line, on a controller that is idle or locked: late answers to lines of
        an earlier user end here, since the refusal of our own line is the last of them."""
        self.line.write(SYNCHRONISE.encode() + b"\n")
        deadline_s = wall_seconds() + self.settings.answer_within_s
        while wall_seconds() < deadline_s:
            line = self._next_line_or_raw(deadline_s - wall_seconds())
            if isinstance(line, AnswerLine) and line.error is not None:
                while self._next_line_or_raw(LATE_WITHIN_S) is not None:
                    continue
                self._synchronised = True
                return
        raise LinkTimeout(
            "the controller reports its status and answers no line",
            hint="is another program's motion under way? reset the controller",
            **self.where,
        )

    def _next_line_or_raw(self, within_s: float) -> Line | bytes | None:
        """The next line; its bytes where it is the tail of something that was said before."""
        raw = self.line.read_line(within_s)
        if raw is None:
            return None
        try:
            return self._record(parse_line(raw))
        except GarbledLineError:
            return raw

    # ------------------------------------------------------------------ ask and tell

    def report(self) -> StatusReport:
        """Ask for the status. Asking again does no harm, so a lost or garbled answer is asked for again."""
        last: ProtocolError | None = None
        for _ in range(self.settings.repeats + 1):
            before = self._reports
            self.line.write(QUERY)
            try:
                self._read_for(self.settings.answer_within_s / (self.settings.repeats + 1), before)
            except ProtocolError as error:
                if "garbled" not in error.where:
                    raise
                last = error
            if self._reports > before and self._last_report is not None:
                return self._last_report
        if last is not None:
            raise last
        raise LinkTimeout(
            f"no status report within {self.settings.answer_within_s:g} s",
            hint="the controller is off, hangs, or is homing",
            **self.where,
        )

    def send(self, line: str) -> SentLine:
        """Send a line; its answer comes later. Never more than the controller's receive buffer holds."""
        ticket = SentLine(line)
        deadline_s = wall_seconds() + self.settings.answer_within_s
        while self._pending and self._buffered(line) >= self.settings.receive_buffer:
            if not self._read_one(deadline_s):
                raise LinkTimeout("the controller takes no further line: its buffer is full", **self.where)
        self._pending.append(ticket)
        self.line.write(line.encode("ascii") + b"\n")
        return ticket

    def ask(self, line: str) -> list[MessageLine | SettingLine]:
        """Send a line that is answered at once; what was told before its ``ok``. CommandRejected for an error."""
        self._messages.clear()
        ticket = self.send(line)
        self.await_answer(ticket)
        self.require_accepted(ticket)
        return list(self._messages)

    def await_answer(self, ticket: SentLine) -> None:
        deadline_s = wall_seconds() + self.settings.answer_within_s
        restarts = self.restarts
        while not ticket.answered:
            if self.restarts != restarts:
                raise ProtocolError(f"the controller has restarted instead of answering {ticket.line!r}", **self.where)
            if not self._read_one(deadline_s):
                raise LinkTimeout(
                    f"no answer to {ticket.line!r} within {self.settings.answer_within_s:g} s", **self.where
                )

    def require_accepted(self, ticket: SentLine) -> None:
        error = ticket.answer.error if ticket.answer is not None else None
        if error is None:
            return
        hint = (
            "clear the alarm: home the machine, or $X where its position is certain" if error in LOCKED_ERRORS else ""
        )
        raise CommandRejected(
            f"the controller refused {ticket.line!r}: {error_text(error)}", hint=hint, error=error, **self.where
        )

    def realtime(self, character: bytes) -> None:
        self.line.write(character)

    def reset(self) -> None:
        """Soft reset, and wait for the welcome. Whatever was under way has no answer any more."""
        restarts = self.restarts
        self.alarm = None
        self.line.write(SOFT_RESET)
        deadline_s = wall_seconds() + self.settings.answer_within_s
        while self.restarts == restarts:
            if not self._read_one(deadline_s):
                raise LinkTimeout("no welcome after a soft reset", hint="reset the controller by hand", **self.where)

    def clear_alarm(self) -> None:
        """A report shows that there is none any more."""
        self.alarm = None

    def drain_for(self, wall_s: float) -> None:
        """Take what comes within so short a wall time."""
        self._read_one(wall_seconds() + wall_s)

    # ------------------------------------------------------------------ what comes

    def _buffered(self, line: str) -> int:
        return sum(len(ticket.line) + 1 for ticket in self._pending) + len(line) + 1

    def _read_for(self, wall_s: float, reports: int) -> None:
        deadline_s = wall_seconds() + wall_s
        while self._reports == reports and self._read_one(deadline_s):
            continue

    def _read_one(self, deadline_s: float) -> bool:
        """Take one line in; False if none has come by then."""
        raw = self.line.read_line(deadline_s - wall_seconds())
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
            case AlarmLine(code):
                self.alarm = code
            case ProbeResult():
                self.probe_results.append(line)
            case WelcomeLine():
                self.restarts += 1
                self._pending.clear()
            case MessageLine() | SettingLine():
                self._messages.append(line)
            case _:
                pass
        return line

    def _answer(self, answer: AnswerLine) -> None:
        if not self._pending:
            if not self._synchronised:
                return  # to a line of an earlier user
            said = "ok" if answer.error is None else f"error:{answer.error}"
            raise ProtocolError(
                f"{said!r} from the controller, and no line waits for an answer",
                hint="an answer came twice, or another program uses this line",
                **self.where,
            )
        self._pending.popleft().answer = answer
