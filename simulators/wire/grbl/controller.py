"""GRBL 1.1 or grblHAL controller in front of the simulated machine, written from the documents and sources of both.

There are two programs, as on the microcontroller that runs GRBL. The interrupt program takes real-time characters out
of the received stream when they arrive. All other characters wait in a receive buffer. The main program
reads one line at a time from this buffer. Like GRBL's main program, it waits while the planner is full, during a dwell
or a probe cycle, and during every hold. It is a generator that yields the condition for which it waits.

The physics does not look ahead over blocks, so the axes come to rest at the end of every block. After a reset during a
motion, the simulated axes brake instead of losing steps, but the alarm is raised nevertheless. A collision is reported
to GRBL as an active limit switch.

Source: gnea/grbl, doc/markdown/interface.md, commands.md, realtime_cmds.md, grbl/protocol.c, system.c and
motion_control.c; grblHAL/core, protocol.c, state_machine.c, motion_control.c, machine_limits.c.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable
from typing import Final

from simulators.wire.grbl import reports
from simulators.wire.grbl.axes import GrblAxes, PlannedMove
from simulators.wire.grbl.blocks import PROBING, BlockError, BlockParser, Triple, WorkOffsets
from simulators.wire.grbl.physics import GrblPhysics
from simulators.wire.grbl.receiver import LineReceiver
from simulators.wire.grbl.reports import (
    ABORTED,
    BEYOND_TRAVEL,
    CRITICAL,
    DOOR_OPEN,
    HARD_LIMIT,
    HOMING_DISABLED,
    HOMING_RESET,
    LOCKED,
    NO_CONTACT,
    NOT_IDLE,
    NOT_READY,
    NOT_RECOGNISED,
    OVERFLOW,
    SOFT_LIMIT,
    GrblState,
    snapshot,
)
from simulators.wire.grbl.settings import GrblSettings

RESET, DOOR, JOG_CANCEL = 0x18, 0x84, 0x85
TOWARDS, NO_ALARM = frozenset({38.2, 38.3}), frozenset({38.3, 38.5})

WaitCondition = Callable[[], bool]
Program = Generator[WaitCondition, None, int | None]
"""Main program; returns the number after ``error:``, or None for ``ok``."""


class GrblController:
    """Simulated GRBL on a serial line: `received` accepts bytes from the line, and the function `send` writes to the
    line.

    `on_advance` and `wakes_at` connect the controller to machine time. If `homed` is False, the controller starts
    locked, as after power-on. If `homing_fails` is set, every homing ends with the alarm of this number. Check mode,
    sleep, startup lines and overrides are not simulated.
    """

    def __init__(
        self,
        physics: GrblPhysics,
        now: Callable[[], float],
        send: Callable[[bytes], None],
        *,
        settings: GrblSettings,
        homed: bool = True,
    ) -> None:
        self.settings = settings
        self._dialect = self.settings.dialect
        self._now = now
        self._send = send
        self._axes = GrblAxes(physics, self.settings, now)
        self._reporter = reports.StatusReporter(self.settings)
        self._parser = BlockParser(WorkOffsets())
        self._probed: tuple[Triple, bool] = ((0.0, 0.0, 0.0), False)
        self.state = GrblState.IDLE if homed or not self._homes else GrblState.ALARM
        self._homed = homed
        self.homing_fails: int | None = None
        self._receiver = LineReceiver(self._dialect)
        self._restart()

    @property
    def _homes(self) -> bool:
        return bool(int(self.settings[22]) & 1)

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
            else:
                self._receiver.store(byte)
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
        silent = self._critical and not self._dialect.reports_when_critical
        if self.state is not GrblState.HOME and not silent:
            blocks = len(self._planner) + (self._axes.current_move is not None)
            now = snapshot(self.state, self._axes, self._parser, blocks=blocks, homed=self._homed)
            self.send_line(self._reporter.report(now, self._receiver.waiting))

    def feed_hold(self) -> None:
        self._run()
        self.cancel_jog_motion()
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
            self._homed = self._homed and self.state is not GrblState.HOME
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
        self._homed = False
        self.state = GrblState.ALARM if self._homes else GrblState.IDLE
        self._restart()
        self._welcome()
        if self.state is GrblState.ALARM and self._dialect.alarm_when_not_homed is not None:
            self.send_line(f"ALARM:{self._dialect.alarm_when_not_homed}")

    def _welcome(self) -> None:
        self._send_lines(("", self._dialect.welcome))
        if self.state is GrblState.ALARM:
            self.send_line(reports.HOW_TO_UNLOCK)

    def cancel_jog(self) -> None:
        """End a jog. grblHAL also discards the lines that wait in the receive buffer, in every state."""
        if self._dialect.cancel_jog_empties_buffer:
            self._receiver.clear()
            self._last_error = 0
        self.cancel_jog_motion()

    def cancel_jog_motion(self) -> None:
        if self.state is GrblState.JOG:
            self._planner.clear()
            self._axes.abort()

    # ------------------------------------------------------------------ main program

    def _restart(self) -> None:
        self._receiver.clear()
        self._last_error = 0
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
                program = self._program
                awaited = next(program)
                if program is self._program:  # it has not reset the controller
                    self._awaited = awaited
            self._end_motion()

    def _can_continue(self) -> bool:
        return self.state not in (GrblState.HOLD, GrblState.DOOR) and not self._critical and self._awaited()

    def _main(self) -> Generator[WaitCondition, None, None]:
        while True:
            yield self._receiver.line_received
            line = self._receiver.take_line()
            self._in_line = True
            code = OVERFLOW if line is None else (yield from self._execute(line))
            self._in_line = False
            self._last_error = code or 0
            self.send_line(f"error:{code}" if code else "ok")

    def _execute(self, line: str) -> Program:
        if not line:
            return None
        if line.startswith("$J"):
            return (yield from self._jog(line))
        if line.startswith("$"):
            return (yield from self._system(line))
        if self.state in (GrblState.ALARM, GrblState.JOG):
            return LOCKED
        if self._last_error and self._dialect.repeats_errors:
            return self._last_error
        return (yield from self._perform(line))

    def _perform(self, line: str) -> Program:
        try:
            block = self._parser.read(line, self._planned_mm)
        except BlockError as error:
            return error.code
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
            yield from self._plan(block.target_mm, None if block.motion == 0 else self._parser.modes.feed_mm_per_min)
        if block.program_end:
            yield self._synchronised
            self.send_line(reports.PROGRAM_END)
        return None

    def _plan(self, target_mm: Triple, feed_mm_per_min: float | None) -> Generator[WaitCondition, None, None]:
        """Queue a move. A move of less than a step is no motion, but it moves the position of the parser."""
        yield lambda: len(self._planner) < self._dialect.planner_blocks
        if not (self._synchronised() and self._axes.at(target_mm)):
            self._planner.append(PlannedMove(target_mm, feed_mm_per_min))
        self._planned_mm = target_mm

    def _jog(self, line: str) -> Program:
        if self.state not in (GrblState.IDLE, GrblState.JOG):
            return NOT_IDLE
        if not line.startswith("$J="):
            return NOT_RECOGNISED
        try:
            target_mm, feed_mm_per_min = self._parser.read_jog(line[3:], self._planned_mm)
        except BlockError as error:
            return error.code
        if self.settings.flag(20) and self._axes.beyond_travel(target_mm):
            return BEYOND_TRAVEL
        yield from self._plan(target_mm, feed_mm_per_min)
        self.state = GrblState.JOG if self._planner else self.state
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
        if not axes.at(target_mm):
            move = PlannedMove(target_mm, self._parser.modes.feed_mm_per_min)
            self._begin(move, touching=towards, leaving=not towards)
            yield self._at_rest
        position = axes.latch_after(latches) if towards else axes.released_at_mm
        if position is not None:
            self._probed = (position, True)
        elif motion in NO_ALARM:
            self._probed = (axes.position(), False)
        else:
            self._alarm(NO_CONTACT)
        # After a miss, the parser stands at the target of the cycle, although the axes stand on a step beside it.
        self._planned_mm = axes.position() if position is not None else target_mm
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
                self._send_lines(self._dialect.build_info)
            case "$N":
                self._send_lines(("$N0=", "$N1="))
            case "$H":
                return (yield from self._home())
            case _:
                return self.settings.store_line(line)
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

    def _home(self) -> Program:
        if not self._homes:
            return HOMING_DISABLED
        self._axes.clear_fault()
        yield lambda: self._axes.idle
        if self.homing_fails is not None:
            self._fail_homing(self.homing_fails)
            yield _never
        pull_off = -self.settings[27]
        self._axes.begin(PlannedMove((pull_off, pull_off, pull_off), self.settings[25]))
        self.state = GrblState.HOME
        yield lambda: not self._axes.moving
        self._axes.set_zero()
        self.state, self._axes.current_move = GrblState.IDLE, None
        self._planned_mm = self._axes.position()
        self._homed = True
        self._reporter.report_homed()
        return None

    def _fail_homing(self, code: int) -> None:
        """Raise an alarm of homing. It resets the controller, which answers the line before its welcome."""
        self._homed = False
        self._alarm(code)
        self.soft_reset()

    # ------------------------------------------------------------------ motion

    def _synchronised(self) -> bool:
        return not self._planner and self._axes.current_move is None and not self._axes.moving

    def _at_rest(self) -> bool:
        return self._axes.current_move is None

    def _dwell_over(self) -> bool:
        return self._dwell_until_s is None or self._now() >= self._dwell_until_s

    def _can_start(self) -> bool:
        free = self.state in (GrblState.IDLE, GrblState.RUN, GrblState.JOG) and self._axes.current_move is None
        return free and bool(self._planner) and self._axes.idle

    def _begin(self, move: PlannedMove, *, touching: bool = False, leaving: bool = False) -> None:
        self.state = GrblState.JOG if self.state is GrblState.JOG else GrblState.RUN
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
        elif self.state is GrblState.JOG and axes.idle:
            self._end_jog()

    def _end_jog(self) -> None:
        self._axes.current_move = None
        if not self._planner:
            self.state, self._planned_mm = GrblState.IDLE, self._axes.position()

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
