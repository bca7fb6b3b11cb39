"""GRBL 1.1 controller in front of the simulated machine, written from GRBL's documents.

There are two programs, as on the microcontroller that runs GRBL. The interrupt program takes real-time characters out
of the received stream when they arrive. All other characters wait in a receive buffer of 128 bytes. The main program
reads one line at a time from this buffer. Like GRBL's main program, it waits while the planner is full, during a dwell
or a probe cycle, and during every hold. It is a generator that yields the condition for which it waits.

The physics does not look ahead over blocks, so the axes come to rest at the end of every block. After a reset during a
motion, the simulated axes brake instead of losing steps, but the alarm is raised nevertheless. A collision is reported
to GRBL as an active limit switch.

Source: gnea/grbl, doc/markdown/interface.md, commands.md, realtime_cmds.md.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable
from enum import Enum
from typing import Final

from simulators.wire.grbl import reports
from simulators.wire.grbl.axes import GrblAxes, PlannedMove
from simulators.wire.grbl.blocks import PROBING, BlockError, BlockParser, GcodeBlock, Triple, WorkOffsets
from simulators.wire.grbl.physics import GrblPhysics
from simulators.wire.grbl.settings import GrblSettings, SettingRefusedError

RECEIVE_BUFFER: Final = 128
"""Size of the receive buffer in bytes; one byte is never used."""
LINE_BUFFER: Final = 80
PLANNER_BLOCKS: Final = 15

HARD_LIMIT, SOFT_LIMIT, ABORTED, NOT_READY, NO_CONTACT, HOMING_RESET = 1, 2, 3, 4, 5, 6
CRITICAL: Final = frozenset({HARD_LIMIT, SOFT_LIMIT})
BAD_NUMBER, NOT_RECOGNISED, HOMING_DISABLED, NOT_IDLE, LOCKED, OVERFLOW, DOOR_OPEN = 2, 3, 5, 8, 9, 11, 13

RESET, DOOR, JOG_CANCEL = 0x18, 0x84, 0x85
TOWARDS, NO_ALARM = frozenset({38.2, 38.3}), frozenset({38.3, 38.5})

WaitCondition = Callable[[], bool]
Program = Generator[WaitCondition, None, int | None]
"""Main program; returns the number after ``error:``, or None for ``ok``."""


class GrblState(Enum):
    IDLE = "Idle"
    RUN = "Run"
    HOLD = "Hold"
    DOOR = "Door"
    ALARM = "Alarm"
    HOME = "Home"


class GrblController:
    """Simulated GRBL on a serial line: `received` accepts bytes from the line, and the function `send` writes to the
    line.

    `on_advance` and `wakes_at` connect the controller to machine time. If `homed` is False, the controller starts
    locked, as after power-on. Check mode, sleep, jogging, startup lines and overrides are not simulated.
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
        self._parser = BlockParser(WorkOffsets())
        self._probed: tuple[Triple, bool] = ((0.0, 0.0, 0.0), False)
        self.state = GrblState.IDLE if homed or not self.settings.flag(22) else GrblState.ALARM
        self._restart()

    @property
    def offsets(self) -> WorkOffsets:
        return self._parser.offsets

    # ------------------------------------------------------------------ the line

    def received(self, data: bytes) -> None:
        """Handle the real-time characters among the received bytes at once, and store the other bytes for the main
        program, which reads them line by line.
        """
        for byte in data:
            if byte in _REALTIME:
                _REALTIME[byte](self)
            elif byte < 0x80 and len(self._waiting) < RECEIVE_BUFFER - 1:
                self._waiting.append(byte)
        self._run()

    def on_advance(self, _now_s: float) -> None:
        """React to a door that was opened, and continue the main program, which executes lines. This is called each
        time the simulated time has advanced."""
        if self._axes.door_open and self.state is not GrblState.DOOR:
            self.open_door()
        self._run()

    def wakes_at(self) -> float | None:
        """Return the next instant in s at which `on_advance` must be called, or None if there is none."""
        known = [instant for instant in (self._axes.next_event_s(), self._dwell_until_s) if instant is not None]
        return min(known, default=None)

    def send_line(self, line: str) -> None:
        self._send(line.encode("ascii") + b"\r\n")

    # ------------------------------------------------------------------ real-time characters

    def query(self) -> None:
        self._run()
        if self.state is not GrblState.HOME and not self._critical:
            self.send_line(self._reporter.report(self._snapshot()))

    def feed_hold(self) -> None:
        self._run()
        if self.state in (GrblState.IDLE, GrblState.RUN):
            self._suspend(GrblState.HOLD)

    def open_door(self) -> None:
        if self.state in (GrblState.IDLE, GrblState.RUN, GrblState.HOLD):
            self.send_line(reports.CHECK_DOOR)
            self._suspend(GrblState.DOOR)

    def cycle_start(self) -> None:
        held = self.state in (GrblState.HOLD, GrblState.DOOR)
        if not held or self._axes.moving or self._axes.door_open:
            return
        self.state = GrblState.RUN if self._axes.current_move is not None else GrblState.IDLE
        self._axes.resume()

    def soft_reset(self) -> None:
        """Abort the motion and discard all lines. If the axes were moving, their position is uncertain, and an alarm is
        raised.
        """
        if self._axes.moving and self.state is not GrblState.ALARM:
            self.send_line(f"ALARM:{HOMING_RESET if self.state is GrblState.HOME else ABORTED}")
            self.state = GrblState.ALARM
        self._axes.abort()
        if self._in_line:
            self.send_line("ok")  # the aborted line is answered before the restart
        self.state = GrblState.ALARM if self.state is GrblState.ALARM else GrblState.IDLE
        self._restart()
        self._welcome()

    def reboot(self) -> None:
        """Restart the controller as after power-on. The position is lost.

        If homing is enabled, the controller is locked until it is homed.
        """
        self._axes.abort()
        self.state = GrblState.ALARM if self.settings.flag(22) else GrblState.IDLE
        self._restart()
        self._welcome()

    def _welcome(self) -> None:
        self._send_lines(("", reports.WELCOME))
        if self.state is GrblState.ALARM:
            self.send_line(reports.LOCKED)

    def cancel_jog(self) -> None:
        """Do nothing: jogging is not simulated."""

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
        self._parser = BlockParser(self._parser.offsets)
        self._planned_mm = self._axes.position()
        self._reporter.restart()
        self._program = self._main()
        self._awaited: WaitCondition = next(self._program)

    def _run(self) -> None:
        """Run the main program until it must wait, and start planned moves until none can be started."""
        self._end_motion()
        while self._can_continue() or self._can_start():
            if self._can_start():
                self._begin(self._planner.popleft())
            if self._can_continue():
                self._awaited = next(self._program)
            self._end_motion()

    def _can_continue(self) -> bool:
        return self.state not in (GrblState.HOLD, GrblState.DOOR) and not self._critical and self._awaited()

    def _main(self) -> Generator[WaitCondition, None, None]:
        while True:
            yield self._line_received
            line = "".join(self._reading)
            self._reading, self._comment, self._line_complete = [], "", False
            self._in_line = True
            code = OVERFLOW if len(line) >= LINE_BUFFER else (yield from self._execute(line))
            self._in_line = False
            self.send_line(f"error:{code}" if code else "ok")

    def _line_received(self) -> bool:
        """Take bytes from the receive buffer up to the end of a line, dropping blanks and comments.

        Returns True if the line is complete.
        """
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
        if self.state is GrblState.ALARM:
            return LOCKED
        try:
            block = self._parser.read(line, self._planned_mm)
        except BlockError as error:
            return error.code
        return (yield from self._perform(block))

    def _perform(self, block: GcodeBlock) -> Program:
        if block.dwell_s is not None:
            yield self._synchronised
            self._dwell_until_s = self._now() + block.dwell_s
            yield self._dwell_over
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
            self.send_line(reports.PROGRAM_END)
        return None

    def _probe(self, motion: float, target_mm: Triple) -> Program:
        """Execute G38.n once all earlier motion has finished, and send the message with the result before the
        answer.
        """
        yield self._synchronised
        towards, axes = motion in TOWARDS, self._axes
        self._probed = (self._probed[0], False)
        if axes.pin == towards:
            self._alarm(NOT_READY)
            return None
        latches = axes.latches
        self._begin(PlannedMove(target_mm, self._parser.modes.feed_mm_per_min), touching=towards, leaving=not towards)
        yield self._at_rest
        position = axes.latch_after(latches) if towards else axes.released_at_mm
        if position is not None:
            self._probed = (position, True)
        elif motion in NO_ALARM:
            self._probed = (axes.position(), False)
        else:
            self._alarm(NO_CONTACT)
        self._planned_mm = axes.position()
        self.send_line(reports.probe_message(*self._probed, inches=self.settings.flag(13)))
        return None

    # ------------------------------------------------------------------ `$` commands

    def _system(self, line: str) -> Program:
        match line:
            case "$":
                self.send_line(reports.HELP)
            case "$G":
                self.send_line(reports.parser_state(self._parser.modes))
            case "$X":
                return self._unlock()
            case "$$":
                if self.state in (GrblState.RUN, GrblState.HOLD):
                    return NOT_IDLE
                self._send_lines(self.settings.lines())
            case _ if self.state not in (GrblState.IDLE, GrblState.ALARM):
                return NOT_IDLE
            case "$#":
                inches = self.settings.flag(13)
                self._send_lines(reports.parameters(self.offsets, self._parser.modes, inches=inches))
                self.send_line(reports.probe_message(*self._probed, inches=inches))
            case "$I":
                self._send_lines(("[VER:1.1h.20190830:volcal simulated machine]", "[OPT:VL,15,128]"))
            case "$N":
                self._send_lines(("$N0=", "$N1="))
            case "$H":
                return (yield from self._home())
            case _:
                return self._store_setting(line)
        return None

    def _send_lines(self, lines: Iterable[str]) -> None:
        for line in lines:
            self.send_line(line)

    def _unlock(self) -> int | None:
        if self._axes.door_open:
            return DOOR_OPEN
        if self.state is GrblState.ALARM:
            self.send_line(reports.UNLOCKED)
            self.state = GrblState.IDLE
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
        self.state = GrblState.HOME
        yield lambda: not self._axes.moving
        self.state, self._axes.current_move = GrblState.IDLE, None
        self._planned_mm = self._axes.position()
        return None

    # ------------------------------------------------------------------ motion

    def _synchronised(self) -> bool:
        return not self._planner and self._axes.current_move is None and not self._axes.moving

    def _at_rest(self) -> bool:
        return self._axes.current_move is None

    def _dwell_over(self) -> bool:
        return self._dwell_until_s is None or self._now() >= self._dwell_until_s

    def _can_start(self) -> bool:
        free = self.state in (GrblState.IDLE, GrblState.RUN) and self._axes.current_move is None
        return free and bool(self._planner) and self._axes.idle

    def _begin(self, move: PlannedMove, *, touching: bool = False, leaving: bool = False) -> None:
        self.state = GrblState.RUN
        if not self._axes.begin(move, touching=touching, leaving=leaving):
            self._alarm(HARD_LIMIT)

    def _end_motion(self) -> None:
        """Update the state if the probe has separated, the axes have failed, or the motion is complete."""
        axes = self._axes
        axes.watch_pin()
        if axes.failed and not self._critical and self.state is not GrblState.ALARM:
            self._alarm(HARD_LIMIT)
        elif axes.current_move is not None and axes.idle and self.state is GrblState.RUN:
            axes.current_move = None
            self.state = GrblState.RUN if self._planner else GrblState.IDLE

    def _suspend(self, state: GrblState) -> None:
        self.state = state
        self._axes.hold()

    def _alarm(self, code: int) -> None:
        self.state, self._axes.current_move = GrblState.ALARM, None
        self._planner.clear()
        self._planned_mm = self._axes.position()
        self.send_line(f"ALARM:{code}")
        if code in CRITICAL:
            self._critical = True
            self.send_line(reports.RESET_TO_CONTINUE)

    # ------------------------------------------------------------------ status

    def _snapshot(self) -> reports.StatusSnapshot:
        modes, axes = self._parser.modes, self._axes
        spindle = {3: "S", 4: "C"}.get(int(modes.spindle), "")
        return reports.StatusSnapshot(
            state=self._state_shown(),
            moving=axes.moving,
            position_mm=axes.position(),
            work_offset_mm=self._parser.work_offset_mm,
            free_blocks=PLANNER_BLOCKS - len(self._planner) - (axes.current_move is not None),
            free_bytes=RECEIVE_BUFFER - len(self._waiting),
            feed_mm_per_min=axes.feed_mm_per_min,
            speed_rpm=modes.speed_rpm if spindle else 0.0,
            pins="P" * axes.pin + "D" * axes.door_open,
            accessories=spindle + {8: "F", 7: "M"}.get(int(modes.coolant), ""),
        )

    def _state_shown(self) -> str:
        if self.state is GrblState.HOLD:
            return f"Hold:{int(self._axes.moving)}"
        if self.state is GrblState.DOOR:
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
    JOG_CANCEL: GrblController.cancel_jog,
}
