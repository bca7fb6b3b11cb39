"""Controller of the simulated machine: it executes commands, tracks the axes, and stores (latches) the axis positions
at which the probe trips in a touch.

All events of a motion are computed when the motion begins. Simulated time may therefore advance in steps of any size,
and each event still has its exact instant.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from drivers.errors import CommandRejected
from drivers.roles import AxisLimits, MotionState, Permission, StoreLimits, TableImage
from simulators.scenario import Scenario
from simulators.world.contact import ContactSolver
from simulators.world.field import FieldOfMany, TipShift
from simulators.world.field_changes import FieldChanges
from simulators.world.lost_motion import PlayOperator
from simulators.world.motion_forecast import MotionCommand, MotionForecast, MoveKind, PathEvents, forecast_motion
from simulators.world.noise import BY_STEP, NoiseSource
from simulators.world.path_lookahead import PathLookahead
from simulators.world.tables import TableBanks
from simulators.world.trigger import Trigger
from simulators.world.workpiece import WorkpieceSnapshot
from simulators.world.worktable import Worktable
from twin.arrays import Array
from twin.collision.geometry import Point, point
from twin.collision.motion_law import MotionLaw, straight_path, trapezoid
from twin.machine.machine_description import MachineDescription

GUARD_TRIPPED = "probe tripped in a guarded move"
"""Fault of a guarded move in which the probe tripped; any other fault is one of the machine."""
LIMIT_TOLERANCE_MM = 1e-6
# a person jogs slowly: 20 mm/s are 1.2 m/min
JOG_MM_PER_S = 20.0


@dataclass(frozen=True)
class Latch:
    """Displayed axis positions in mm at the last trip of the probe.

    `sequence` is the number of the touch in which the probe tripped.
    """

    sequence: int
    position: Array


@dataclass(slots=True)
class _Motion:
    command: MotionCommand
    law: MotionLaw
    events: PathEvents
    forecast: MotionForecast
    ends_in: MotionState = MotionState.IDLE
    reason: str = ""


class Controller:
    """Simulated machine controller, which executes one motion at a time.

    A command that cannot be executed raises CommandRejected and changes nothing.
    """

    def __init__(
        self,
        scenario: Scenario,
        *,
        machine_field: FieldOfMany | None,
        table: Worktable,
        changes: FieldChanges,
        on_motion: Callable[[], None],
        on_collision: Callable[[str, str], None],
    ) -> None:
        settings = scenario.settings
        self._limits = axis_limits(scenario.machine)
        self._tool = point(scenario.machine.tool(settings.tool))
        self._table = table
        self._changes = changes
        self._trigger = Trigger(settings.trigger, settings.seed, scenario.frame)
        self._play = PlayOperator(settings.axes, settings.seed)
        self._homing_sigma_um = settings.axes.homing_of_axes_um
        self._homing_noise = NoiseSource(settings.seed, "homing")
        self._homings = 0
        self._shift = TipShift(machine_field)
        reach = table.ball_radius_mm + settings.probe.tip_radius_mm
        self.contacts = ContactSolver(self._tool, reach, self._shift)
        by_hand = settings.placed_by_hand is not None
        self._lookahead = PathLookahead(self._tool, self.contacts, self._trigger, trips_on_bodies=by_hand)
        self._tables = TableBanks(settings.store)
        self._on_motion, self._on_collision = on_motion, on_collision
        self._position: Point = scenario.start_mm
        self._motion: _Motion | None = None
        self._held: MotionCommand | None = None
        self._state = MotionState.IDLE
        self._deflected = False
        self._touches = 0
        self._by_step = settings.noise_by_step
        self._tag = 0
        self.now_s = 0.0
        self.fault = ""
        self.latch: Latch | None = None
        self.touch_missed = False
        self.probe_loaded = True
        self.probe_healthy = True
        self.deflected_by_hand = False
        """True while a person deflects the stylus with a finger."""
        self.granted = dict.fromkeys(Permission, True)

    # ------------------------------------------------------------------ state

    def limits(self) -> AxisLimits:
        return self._limits

    @property
    def tool_offset(self) -> Point:
        return self._tool

    @property
    def motion(self) -> MotionState:
        return self._state if self._motion is None else MotionState.MOVING

    @property
    def motion_ends_s(self) -> float | None:
        """Instant in s at which the current motion ends if no command or fault intervenes; None if the axes do not
        move.
        """
        return None if self._motion is None else self._motion.forecast.end_s

    @property
    def probe_free_s(self) -> float | None:
        """Instant in s at which a probe that was deflected at the start of the current motion loses contact.

        The value is None if the probe is not deflected or if the axes do not move.
        """
        return self._motion.forecast.free_s if self._motion is not None and self._deflected else None

    def displayed_at(self, instant_s: float) -> Point:
        """Return the axis positions in mm that are displayed at `instant_s`, now or in the future.

        A future position is a forecast, which assumes that no other command or fault occurs before `instant_s`.
        """
        if self._motion is None:
            return self._position
        return self._motion.command.path.at(self._motion.forecast.law.distance_at(instant_s))

    def displayed_position(self) -> Array:
        return np.array(self.displayed_at(self.now_s))

    @property
    def permissions(self) -> dict[Permission, bool]:
        return {**self.granted, Permission.NO_FAULT: self._state is not MotionState.FAULT}

    @property
    def probe_deflected(self) -> bool:
        if self.deflected_by_hand:
            return True
        if self._motion is None:
            return self._deflected and self._contacted_ball(self._table.snapshot(self.now_s)) is not None
        forecast = self._motion.forecast
        tripped = forecast.trip_s is not None and self.now_s >= forecast.trip_s
        return tripped or (self._deflected and self.now_s < forecast.free_s)

    def temperatures(self) -> dict[str, float]:
        return self._changes.thermal.temperatures_c(self.now_s)

    # ------------------------------------------------------------------ motion commands

    def trace(self, tag: int) -> None:
        """Assign the following motions to the step of the agent's plan with the number `tag`, or to no step if `tag` is
        0.

        If the key `noise_by_step` of the scenario is True, the noise of a motion depends on its step and not on the
        running number of the motion.
        """
        self._tag = tag

    def begin_move(self, target: ArrayLike, feed_mm_per_s: float | None, guarded: bool) -> None:
        """Start a straight move to `target` in mm, at rapid speed if `feed_mm_per_s` is None.

        If `guarded` is True and the probe trips, the axes stop and the controller enters the fault state.
        """
        self._begin(MoveKind.GUARDED if guarded else MoveKind.POSITIONING, target, feed_mm_per_s)

    def begin_jog(self, axis: int, distance_mm: float) -> None:
        """Start a move of one axis by `distance_mm`, as a person commands it at the controller's own panel."""
        target = list(self._position)
        target[axis] += distance_mm
        self._begin(MoveKind.POSITIONING, target, JOG_MM_PER_S)

    def begin_touch(self, target: ArrayLike, feed_mm_per_s: float) -> None:
        """Start a straight move to `target` in mm that stops when the probe trips.

        After the move, either `latch` has a new sequence number or, if the probe did not trip, `touch_missed` is True.
        """
        self._begin(MoveKind.TOUCH, target, feed_mm_per_s)

    def set_zero(self) -> None:
        """Set the displayed zero of every axis anew, as at the end of a homing. It scatters from homing to homing."""
        self._homings += 1
        noise = self._homing_noise.normal(self._homings if self._noise_step is None else self._noise_step)
        self._shift.homing = point([1e-3 * s * n for s, n in zip(self._homing_sigma_um, noise, strict=True)])
        self.contacts.forget()

    @property
    def homing_offset_mm(self) -> Point:
        """Offset of the displayed zero of X, Y and Z in mm that the last homing has left."""
        return self._shift.homing

    @property
    def _noise_step(self) -> int | None:
        """Number that selects the noise of the present step, or None if a running number does.

        Noise by step keeps the readings of a resumed run equal to those of an uninterrupted one, although the numbers
        of their motions differ.
        """
        return BY_STEP + self._tag if self._by_step and self._tag else None

    def hold(self) -> None:
        """Brake the axes along their path, and store the motion command; the method `resume` completes that command
        later.
        """
        if self._motion is not None and self._motion.ends_in is MotionState.IDLE:
            self._held = self._motion.command
            self._brake(MotionState.HELD)

    def resume(self) -> None:
        if self._state is MotionState.HELD and self._motion is None and self._held is not None:
            command, self._held = self._held, None
            self._state = MotionState.IDLE
            self._begin(command.kind, command.target, command.speed)

    def halt(self) -> None:
        """Brake the axes and discard the motion command. A controller in the fault state remains in that state."""
        self._held = None
        if self._motion is not None and self._motion.ends_in is not MotionState.FAULT:
            self._brake(MotionState.IDLE)
        elif self._state is MotionState.HELD:
            self._state = MotionState.IDLE

    def fail(self, reason: str) -> None:
        """Brake the axes and enter the fault state, as after an emergency stop or a lost heartbeat of the agent.

        If the controller is already in a fault, it keeps the reason of the first fault.
        """
        if self._motion is not None:
            self._brake(MotionState.FAULT, reason)
        else:
            self._enter_fault(reason)

    def reset(self) -> None:
        """Clear the fault state of the controller. While the axes move, the method does nothing."""
        if self._state is MotionState.FAULT and self._motion is None:
            self._state, self.fault = MotionState.IDLE, ""

    # ------------------------------------------------------------------ compensation

    @property
    def banks(self) -> dict[int, TableImage]:
        return self._tables.images

    @property
    def applied_tables(self) -> dict[int, TableImage]:
        """Tables of the banks as the controller applies them."""
        return self._tables.applied

    @property
    def active_bank(self) -> int:
        return self._tables.active

    @property
    def store_limits(self) -> StoreLimits:
        return self._tables.limits

    def write_bank(self, bank: int, image: TableImage) -> None:
        self._tables.write(bank, image)

    def activate(self, bank: int) -> None:
        if self._motion is not None:
            raise CommandRejected("a compensation cannot change during a motion")
        self._tables.activate(bank)
        self._shift.table = self._tables.field

    # ------------------------------------------------------------------ time

    def advance_to(self, instant_s: float) -> None:
        self.now_s = instant_s
        motion = self._motion
        if motion is None:
            return
        forecast = motion.forecast
        if forecast.trip_s is not None and instant_s >= forecast.trip_s:
            self._handle_trip(motion, forecast.trip_s)
        if instant_s >= forecast.end_s:
            self._arrive(motion)

    def _begin(self, kind: MoveKind, target: ArrayLike, feed_mm_per_s: float | None) -> None:
        command = self._command(kind, target, feed_mm_per_s)
        snapshot = self._table.snapshot(self.now_s)
        resting = self._contacted_ball(snapshot) if self._deflected else None
        self._shift.drift = self._changes.thermal.drift_mm(self.now_s)
        self._shift.change = self._changes.field(self.now_s)
        step = self._noise_step
        self._shift.play = self._play.after(self._position, command.target, step)
        events = self._lookahead.events_on(command, snapshot, resting, self._touches if step is None else step)
        law = trapezoid(self.now_s, command.path.length, command.speed, command.acceleration)
        self._touches += kind is MoveKind.TOUCH
        self._deflected = resting is not None
        self.touch_missed = False
        self._motion = _Motion(command, law, events, forecast_motion(law, events, command.acceleration))
        self._on_motion()
        self.advance_to(self.now_s)

    def _command(self, kind: MoveKind, target: ArrayLike, feed_mm_per_s: float | None) -> MotionCommand:
        self._require_ready(kind)
        goal = point(np.asarray(target, dtype=np.float64).tolist())
        self._require_inside(goal)
        if feed_mm_per_s is not None and not 0.0 < feed_mm_per_s < math.inf:
            raise CommandRejected(f"feed must be positive, got {feed_mm_per_s} mm/s")
        path = straight_path(self._position, goal)
        speed = min(feed_mm_per_s or math.inf, path.limit_along(self._limits.rapid_mm_per_s))
        return MotionCommand(kind, goal, path, speed, path.limit_along(self._limits.acceleration_mm_per_s2))

    def _require_ready(self, kind: MoveKind) -> None:
        if self.motion is not MotionState.IDLE:
            raise CommandRejected(f"the machine is not ready for a {kind.value}: {self.motion.value} {self.fault}")
        if not all(self.granted.values()):
            missing = [name.value for name, given in self.granted.items() if not given]
            raise CommandRejected(f"no {kind.value} is permitted; missing: {', '.join(missing)}")
        if kind is not MoveKind.POSITIONING and not (self.probe_loaded and self.probe_healthy):
            raise CommandRejected(f"no {kind.value} without a healthy probe in the spindle")
        if kind is not MoveKind.POSITIONING and self.deflected_by_hand:
            raise CommandRejected(f"no {kind.value} while a person deflects the stylus")

    def _require_inside(self, goal: Point) -> None:
        limits = zip("XYZ", goal, self._limits.lower_mm, self._limits.upper_mm, strict=True)
        for axis, value, low, high in limits:
            if not low - LIMIT_TOLERANCE_MM <= value <= high + LIMIT_TOLERANCE_MM:
                raise CommandRejected(f"{axis} {value:.3f} mm is outside {low:g} to {high:g} mm", axis=axis)

    def _brake(self, ends_in: MotionState, reason: str = "") -> None:
        """Brake now. Forecast events beyond the new end of the path are dropped; those before it still happen."""
        motion = self._motion
        assert motion is not None  # noqa: S101  checked by the callers
        motion.ends_in, motion.reason = ends_in, motion.reason or reason
        forecast = motion.forecast
        # After a trip the axes brake already, along the law of the forecast.
        if forecast.trip_s is not None and self.now_s >= forecast.trip_s:
            return
        motion.law = motion.law.braked_from(self.now_s, motion.command.acceleration)
        motion.forecast = forecast_motion(motion.law, motion.events, motion.command.acceleration)
        self._on_motion()
        self.advance_to(self.now_s)  # a motion that has not left its start, or stands at its end, ends at once

    def _handle_trip(self, motion: _Motion, instant_s: float) -> None:
        if motion.command.kind is MoveKind.GUARDED:
            motion.ends_in, motion.reason = MotionState.FAULT, motion.reason or GUARD_TRIPPED
        elif self.latch is None or self.latch.sequence < self._touches:
            assert motion.events.trip_mm is not None  # noqa: S101  a trip implies it
            # From the path distance, not from the instant: the same touch latches the same position at any time.
            command = motion.command
            lag_mm = self._trigger.latch_lag_mm(command.speed, command.acceleration)
            position = command.path.at(motion.events.trip_mm + lag_mm)
            self.latch = Latch(self._touches, np.array(position))

    def _arrive(self, motion: _Motion) -> None:
        forecast, command = motion.forecast, motion.command
        interrupted = forecast.trip_s is not None or forecast.crash is not None
        # A path that was braked ends short of its target; rounding must not make a complete one look short.
        complete = not interrupted and forecast.law.end_distance >= command.path.length - 1e-9
        self._position = command.target if complete else command.path.at(forecast.law.end_distance)
        self._motion = None
        # by the distance: a motion that is halted at its start ends at the instant at which it would begin to separate
        still = self._deflected and forecast.law.end_distance < motion.events.free_mm
        self._deflected = forecast.trip_s is not None or still
        self.touch_missed = command.kind is MoveKind.TOUCH and complete
        self._state = motion.ends_in
        if forecast.crash is not None:
            self._deflected = True
            self._on_collision(forecast.crash.moving, forecast.crash.obstacle)
            self._enter_fault(f"collision: {forecast.crash.moving} with {forecast.crash.obstacle}")
        elif motion.ends_in is MotionState.FAULT:
            self._enter_fault(motion.reason)
        elif motion.ends_in is MotionState.HELD and (complete or interrupted):
            self._state, self._held = MotionState.IDLE, None

    def _enter_fault(self, reason: str) -> None:
        self._state, self._held = MotionState.FAULT, None
        self.fault = self.fault or reason

    def _contacted_ball(self, snapshot: WorkpieceSnapshot) -> int | None:
        """Return the ball that deflects the probe, or None.

        Called only if the probe was deflected before. If the bar has turned or moved away since, the probe is free; a
        bar that turns into the probe is a collision.
        """
        resting = self.contacts.resting_on(self._position, snapshot)
        self._deflected = resting is not None
        return resting


def axis_limits(machine: MachineDescription) -> AxisLimits:
    """Return the travel and the dynamics of the axes from the machine file: positions in mm, speeds in mm/s and
    accelerations in mm/s².
    """
    (x0, x1), (y0, y1), (z0, z1) = machine.limits
    rx, ry, rz = machine.rapid_mm_per_min
    return AxisLimits((x0, y0, z0), (x1, y1, z1), (rx / 60, ry / 60, rz / 60), machine.acceleration_mm_per_s2)
