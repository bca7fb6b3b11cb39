"""A GRBL 1.1 controller in front of the simulated machine, written from GRBL's documents.

Two programs share it, as on the chip. Real-time characters are taken out of the stream the instant they arrive. Lines
wait in a receive buffer of 128 bytes for the main program, which reads one at a time and stands still where GRBL's
does: while the planner is full, until a dwell or a probe cycle has finished, and through every hold. It is written as
a generator that yields what it waits for.

The physics has no look-ahead over blocks: every block is braked to rest. After a reset in motion the simulated axes
brake instead of losing steps; the alarm comes all the same. A collision reaches GRBL as its limit input.

Source: gnea/grbl, doc/markdown/interface.md, commands.md, realtime_cmds.md.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable
from enum import Enum
from typing import Final

from simulators.wire.grbl import reports
from simulators.wire.grbl.axes import GrblAxes, PlannedMove
from simulators.wire.grbl.blocks import PROBING, Block, BlockError, Offsets, Parser, Triple
from simulators.wire.grbl.physics import GrblPhysics
from simulators.wire.grbl.settings import GrblSettings, SettingRefusedError

RECEIVE_BUFFER: Final = 128
"""Bytes, of which one is never used."""
LINE_BUFFER: Final = 80
PLANNER_BLOCKS: Final = 15

HARD_LIMIT, SOFT_LIMIT, ABORTED, NOT_READY, NO_CONTACT, HOMING_RESET = 1, 2, 3, 4, 5, 6
CRITICAL: Final = frozenset({HARD_LIMIT, SOFT_LIMIT})
BAD_NUMBER, NOT_RECOGNISED, HOMING_DISABLED, NOT_IDLE, LOCKED, OVERFLOW, DOOR_OPEN = 2, 3, 5, 8, 9, 11, 13

RESET, DOOR, JOG_CANCEL = 0x18, 0x84, 0x85
TOWARDS, NO_ALARM = frozenset({38.2, 38.3}), frozenset({38.3, 38.5})

Awaited = Callable[[], bool]
Program = Generator[Awaited, None, int | None]
"""Ends with the number after ``error:``, None for ``ok``."""


class State(Enum):
    IDLE = "Idle"
    RUN = "Run"
    HOLD = "Hold"
    DOOR = "Door"
    ALARM = "Alarm"
    HOME = "Home"


class GrblController:
    """`received` takes bytes from the line, `send` puts bytes on it; `moved_to` and `wakes_at` tie it to time.

    Homed when it starts, unless `homed` is False: then it is locked, as after switching on. Not simulated: check mode,
    sleep, jogging, startup lines, overrides.
    """

    def __init__(
        self,
        physics: GrblPhysics,
        now: Callable[[], float],
        send: Callable[[bytes], None],
        *,
        settings: GrblSettings | None = None,
        homed: bool = True,
    ) -> None:
        self.settings = settings or GrblSettings(physics.limits())
        self._now = now
        self._send = send
        self._axes = GrblAxes(physics, self.settings, now)
        self._reporter = reports.StatusReporter(self.settings)
        self._parser = Parser(Offsets())
        self._probed: tuple[Triple, bool] = ((0.0, 0.0, 0.0), False)
        self.state = State.IDLE if homed or not self.settings.flag(22) else State.ALARM
        self._restart()

    @property
    def offsets(self) -> Offsets:
        return self._parser.offsets

    # ------------------------------------------------------------------ the line

    def received(self, data: bytes) -> None:
        """Real-time characters act at once; the rest waits for the main program."""
        for byte in data:
            if byte in _REALTIME:
                _REALTIME[byte](self)
            elif byte < 0x80 and len(self._waiting) < RECEIVE_BUFFER - 1:
                self._waiting.append(byte)
        self._go_on()

    def moved_to(self, _now_s: float) -> None:
        """The world has moved on."""
        if self._axes.door_open and self.state is not State.DOOR:
            self.open_door()
        self._go_on()

    def wakes_at(self) -> float | None:
        """The next instant at which something here must react."""
        known = [instant for instant in (self._axes.next_event_s(), self._dwell_until_s) if instant is not None]
        return min(known, default=None)

    def say(self, line: str) -> None:
        self._send(line.encode("ascii") + b"\r\n")

    # ------------------------------------------------------------------ real-time characters

    def query(self) -> None:
        self._go_on()
        if self.state is not State.HOME and not self._critical:
            self.say(self._reporter.report(self._snapshot()))

    def feed_hold(self) -> None:
        self._go_on()
        if self.state in (State.IDLE, State.RUN):
            self._suspend(State.HOLD)

    def open_door(self) -> None:
        if self.state in (State.IDLE, State.RUN, State.HOLD):
            self.say(reports.CHECK_DOOR)
            self._suspend(State.DOOR)

    def cycle_start(self) -> None:
        held = self.state in (State.HOLD, State.DOOR)
        if not held or self._axes.moving or self._axes.door_open:
            return
        self.state = State.RUN if self._axes.under_way is not None else State.IDLE
        self._axes.resume()

    def soft_reset(self) -> None:
        """What moves is broken off, and then its position is not certain any more."""
        if self._axes.moving and self.state is not State.ALARM:
            self.say(f"ALARM:{HOMING_RESET if self.state is State.HOME else ABORTED}")
            self.state = State.ALARM
        self._axes.break_off()
        if self._in_line:
            self.say("ok")  # the line that is broken off is answered before everything begins anew
        self.state = State.ALARM if self.state is State.ALARM else State.IDLE
        self._restart()
        self._welcome()

    def reboot(self) -> None:
        """Power comes back: position lost, locked until it is homed, if it can home."""
        self._axes.break_off()
        self.state = State.ALARM if self.settings.flag(22) else State.IDLE
        self._restart()
        self._welcome()

    def _welcome(self) -> None:
        self._say_all(("", reports.WELCOME))
        if self.state is State.ALARM:
            self.say(reports.LOCKED)

    def nothing(self) -> None:
        """Cancels a jog; nothing here jogs."""

    # ------------------------------------------------------------------ main program

    def _restart(self) -> None:
        self._waiting = bytearray()
        self._reading: list[str] = []
        self._comment = ""
        self._line_complete = False
        self._planner: deque[PlannedMove] = deque()
        self._critical = False
        self._in_line = False
        self._dwell_until_s: float | None = None
        self._parser = Parser(self._parser.offsets)
        self._planned_mm = self._axes.position()
        self._reporter.begin_anew()
        self._program = self._main()
        self._awaited: Awaited = next(self._program)

    def _go_on(self) -> None:
        """Run the main program until it must wait, and the planner until it has nothing to start."""
        self._end_motion()
        while self._awaited_now() or self._can_start():
            if self._can_start():
                self._begin(self._planner.popleft())
            if self._awaited_now():
                self._awaited = next(self._program)
            self._end_motion()

    def _awaited_now(self) -> bool:
        return self.state not in (State.HOLD, State.DOOR) and not self._critical and self._awaited()

    def _main(self) -> Generator[Awaited, None, None]:
        while True:
            yield self._line_has_come
            line = "".join(self._reading)
            self._reading, self._comment, self._line_complete = [], "", False
            self._in_line = True
            code = OVERFLOW if len(line) >= LINE_BUFFER else (yield from self._execute(line))
            self._in_line = False
            self.say(f"error:{code}" if code else "ok")

    def _line_has_come(self) -> bool:
        """Takes bytes out of the receive buffer up to the end of a line; blanks and comments fall away."""
        while self._waiting and not self._line_complete:
            character = chr(self._waiting.pop(0))
            if character in "\r\n":
                self._line_complete = True
            elif self._comment:
                self._comment = "" if (self._comment, character) == ("(", ")") else self._comment
            elif character in "(;":
                self._comment = character
            elif character > " " and character != "/":
                self._reading.append(character.upper())
        return self._line_complete

    def _execute(self, line: str) -> Program:
        if not line:
            return None
        if line.startswith("$"):
            return (yield from self._system(line))
        if self.state is State.ALARM:
            return LOCKED
        try:
            block = self._parser.read(line, self._planned_mm)
        except BlockError as error:
            return error.code
        return (yield from self._perform(block))

    def _perform(self, block: Block) -> Program:
        if block.dwell_s is not None:
            yield self._synchronised
            self._dwell_until_s = self._now() + block.dwell_s
            yield self._dwelt
            self._dwell_until_s = None
        if block.target_mm is not None and block.motion is not None:
            if self.settings.flag(20) and self._axes.beyond_travel(block.target_mm):
                yield self._synchronised
                self._alarm(SOFT_LIMIT)
                yield _never
            if block.motion in PROBING:
                return (yield from self._probe(block.motion, block.target_mm))
            yield lambda: len(self._planner) < PLANNER_BLOCKS
            feed = None if block.motion == 0 else self._parser.modes.feed_mm_per_min
            self._planner.append(PlannedMove(block.target_mm, feed))
            self._planned_mm = block.target_mm
        if block.program_end:
            yield self._synchronised
            self.say(reports.PROGRAM_END)
        return None

    def _probe(self, motion: float, target_mm: Triple) -> Program:
        """G38.n: everything before it is finished first; the answer comes after the message of the result."""
        yield self._synchronised
        towards, axes = motion in TOWARDS, self._axes
        self._probed = (self._probed[0], False)
        if axes.pin == towards:
            self._alarm(NOT_READY)
            return None
        latches = axes.latches
        self._begin(PlannedMove(target_mm, self._parser.modes.feed_mm_per_min), touching=towards, leaving=not towards)
        yield self._at_rest
        found = axes.latch_after(latches) if towards else axes.left_at_mm
        if found is not None:
            self._probed = (found, True)
        elif motion in NO_ALARM:
            self._probed = (axes.position(), False)
        else:
            self._alarm(NO_CONTACT)
        self._planned_mm = axes.position()
        self.say(reports.probe_message(*self._probed, inches=self.settings.flag(13)))
        return None

    # ------------------------------------------------------------------ `$` commands

    def _system(self, line: str) -> Program:
        match line:
            case "$":
                self.say(reports.HELP)
            case "$G":
                self.say(reports.parser_state(self._parser.modes))
            case "$X":
                return self._unlock()
            case "$$":
                if self.state in (State.RUN, State.HOLD):
                    return NOT_IDLE
                self._say_all(self.settings.lines())
            case _ if self.state not in (State.IDLE, State.ALARM):
                return NOT_IDLE
            case "$#":
                inches = self.settings.flag(13)
                self._say_all(reports.parameters(self.offsets, self._parser.modes, inches=inches))
                self.say(reports.probe_message(*self._probed, inches=inches))
            case "$I":
                self._say_all(("[VER:1.1h.20190830:volcal simulated machine]", "[OPT:VL,15,128]"))
            case "$N":
                self._say_all(("$N0=", "$N1="))
            case "$H":
                return (yield from self._home())
            case _:
                return self._store_setting(line)
        return None

    def _say_all(self, lines: Iterable[str]) -> None:
        for line in lines:
            self.say(line)

    def _unlock(self) -> int | None:
        if self._axes.door_open:
            return DOOR_OPEN
        if self.state is State.ALARM:
            self.say(reports.UNLOCKED)
            self.state = State.IDLE
            self._axes.clear_fault()
        return None

    def _store_setting(self, line: str) -> int | None:
        name, separator, value = line[1:].partition("=")
        if not (separator and name.isdecimal()):
            return NOT_RECOGNISED
        try:
            self.settings.store(int(name), float(value))
        except SettingRefusedError as refusal:
            return refusal.code
        except ValueError:
            return BAD_NUMBER
        return None

    def _home(self) -> Program:
        if not self.settings.flag(22):
            return HOMING_DISABLED
        self._axes.clear_fault()
        yield lambda: self._axes.idle
        pull_off = -self.settings[27]
        self._axes.begin(PlannedMove((pull_off, pull_off, pull_off), self.settings[25]))
        self.state = State.HOME
        yield lambda: not self._axes.moving
        self.state, self._axes.under_way = State.IDLE, None
        self._planned_mm = self._axes.position()
        return None

    # ------------------------------------------------------------------ motion

    def _synchronised(self) -> bool:
        return not self._planner and self._axes.under_way is None and not self._axes.moving

    def _at_rest(self) -> bool:
        return self._axes.under_way is None

    def _dwelt(self) -> bool:
        return self._dwell_until_s is None or self._now() >= self._dwell_until_s

    def _can_start(self) -> bool:
        free = self.state in (State.IDLE, State.RUN) and self._axes.under_way is None
        return free and bool(self._planner) and self._axes.idle

    def _begin(self, move: PlannedMove, *, touching: bool = False, leaving: bool = False) -> None:
        self.state = State.RUN
        if not self._axes.begin(move, touching=touching, leaving=leaving):
            self._alarm(HARD_LIMIT)

    def _end_motion(self) -> None:
        """What follows from the axes being where they are."""
        axes = self._axes
        axes.watch_pin()
        if axes.failed and not self._critical and self.state is not State.ALARM:
            self._alarm(HARD_LIMIT)
        elif axes.under_way is not None and axes.idle and self.state is State.RUN:
            axes.under_way = None
            self.state = State.RUN if self._planner else State.IDLE

    def _suspend(self, state: State) -> None:
        self.state = state
        self._axes.hold()

    def _alarm(self, code: int) -> None:
        self.state, self._axes.under_way = State.ALARM, None
        self._planner.clear()
        self._planned_mm = self._axes.position()
        self.say(f"ALARM:{code}")
        if code in CRITICAL:
            self._critical = True
            self.say(reports.RESET_TO_CONTINUE)

    # ------------------------------------------------------------------ what it tells

    def _snapshot(self) -> reports.Snapshot:
        modes, axes = self._parser.modes, self._axes
        spindle = {3: "S", 4: "C"}.get(int(modes.spindle), "")
        return reports.Snapshot(
            state=self._state_shown(),
            moving=axes.moving,
            position_mm=axes.position(),
            work_offset_mm=self._parser.work_offset_mm,
            free_blocks=PLANNER_BLOCKS - len(self._planner) - (axes.under_way is not None),
            free_bytes=RECEIVE_BUFFER - len(self._waiting),
            feed_mm_per_min=axes.feed_mm_per_min,
            speed_rpm=modes.speed_rpm if spindle else 0.0,
            pins="P" * axes.pin + "D" * axes.door_open,
            accessories=spindle + {8: "F", 7: "M"}.get(int(modes.coolant), ""),
        )

    def _state_shown(self) -> str:
        if self.state is State.HOLD:
            return f"Hold:{int(self._axes.moving)}"
        if self.state is State.DOOR:
            return "Door:2" if self._axes.moving else f"Door:{int(self._axes.door_open)}"
        return str(self.state.value)


def _never() -> bool:
    return False


_REALTIME: Final[dict[int, Callable[[GrblController], None]]] = {
    ord("?"): GrblController.query,
    ord("!"): GrblController.feed_hold,
    ord("~"): GrblController.cycle_start,
    RESET: GrblController.soft_reset,
    DOOR: GrblController.open_door,
    JOG_CANCEL: GrblController.nothing,
}
