"""One device that implements all device roles with a simulated world in this process. It serves tests and preflights.

The end of each motion is known when the motion begins. The device sleeps on the given clock exactly until this end, and
the sleep advances the world.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from drivers.clock import Clock, Deadline, VirtualClock, without_interrupts
from drivers.errors import CommandRejected, GuardTripped, MotionFault, StoreError
from drivers.roles import (
    AxisLimits,
    DiagnosticFinding,
    HomingDirections,
    MachineStatus,
    Miss,
    MotionState,
    OperatorRequest,
    OperatorTask,
    Orientation,
    PlacementRequest,
    ProbeStatus,
    RotaryMount,
    StoreLimits,
    TableImage,
    Touch,
    Vector,
)
from simulators.world.controller import GUARD_TRIPPED
from simulators.world.mount import AZIMUTH, ELEVATION, MountPhysics
from simulators.world.world import World

HOMING_MM_PER_S = 50.0
"""Speed of the axes towards their switches, 3 m/min."""
HOMING_PULL_OFF_MM = 5.0
"""Distance from the switches at which the axes stand after a homing; more than usual, because a preflight shows with it
that the paths across the table are free."""
POLL_S = 0.05
"""Interval in s at which a motion on hold is polled."""
MOTION_MARGIN_S = 60.0
"""Time in s that a motion may take beyond its forecast. Holds are not counted if the clock tracks them."""


class SimulatedMachineDevice:
    """Device that is machine, probe, rotary mount, compensation store, thermometer and operator at the same time."""

    def __init__(self, world: World, clock: Clock) -> None:
        self.world = world
        self._clock = clock
        self._controller = world.controller
        self._subscribed = False

    # ------------------------------------------------------------------ device

    def open(self) -> None:
        """Connect the simulated world to the clock that was passed to the device.

        A virtual clock advances the world with every sleep. With any other clock, the device advances the world to the
        present time before each answer.
        """
        if isinstance(self._clock, VirtualClock) and not self._subscribed:
            self._clock.subscribe(self.world.advance_to)
            self._subscribed = True

    def close(self) -> None:
        self.stop()

    def stop(self) -> None:
        self._catch_up()
        self._controller.halt()
        for mount in self.world.mounts.values():
            mount.halt()

    def diagnose(self) -> list[DiagnosticFinding]:
        scenario = self.world.scenario
        kind = "without error" if scenario.settings.ideal else "with its own errors"
        return [DiagnosticFinding("simulated machine", True, f"{scenario.machine.name}, {kind}, in this process")]

    # ------------------------------------------------------------------ machine and probe

    def limits(self) -> AxisLimits:
        return self._controller.limits()

    def status(self) -> MachineStatus:
        self._catch_up()
        controller = self._controller
        return MachineStatus(controller.motion, controller.permissions, controller.fault)

    def position(self) -> Vector:
        self._catch_up()
        return self._controller.displayed_position()

    def trace(self, tag: int) -> None:
        self._controller.trace(tag)

    def move_to(self, target_mm: Vector, *, feed_mm_per_s: float | None, guarded: bool) -> None:
        self._catch_up()
        self._controller.begin_move(target_mm, feed_mm_per_s, guarded)
        self._await_motion()

    def why_no_homing(self) -> str:
        return ""

    def homing_directions(self) -> HomingDirections:
        x, y, z = (1 if end > middle else -1 for end, middle in zip(*self._home_ends(), strict=True))
        return x, y, z

    def _home_ends(self) -> tuple[Vector, Vector]:
        """Return the ends of travel at which the axes home, and the middle of the travel, both in mm."""
        scenario = self.world.scenario
        ends = np.array(scenario.frame.withdrawn_corner(scenario.machine.limits))
        return ends, np.array(scenario.machine.limits).mean(axis=1)

    def home_axes(self) -> None:
        """Move to the home position, first along the stylus away from the table, and set the zero of the axes anew.

        The axes pull off from the ends of travel, where their switches are.
        """
        ends, middle = self._home_ends()
        home = ends + HOMING_PULL_OFF_MM * np.sign(middle - ends)
        axis = self.world.scenario.frame.axis
        withdrawn = self.position()
        withdrawn[axis] = home[axis]
        for target_mm in (withdrawn, home):
            self.move_to(target_mm, feed_mm_per_s=HOMING_MM_PER_S, guarded=False)
        self._controller.set_zero()

    def hold(self) -> None:
        self._catch_up()
        self._controller.hold()

    def resume(self) -> None:
        self._catch_up()
        self._controller.resume()

    def reset(self) -> None:
        self._catch_up()
        self._controller.reset()

    def probe_status(self) -> ProbeStatus:
        self._catch_up()
        controller = self._controller
        return ProbeStatus(controller.probe_loaded, controller.probe_healthy, controller.probe_deflected)

    def touch_towards(self, target_mm: Vector, *, feed_mm_per_s: float) -> Touch | Miss:
        self._catch_up()
        controller = self._controller
        before = controller.latch.sequence if controller.latch else 0
        controller.begin_touch(target_mm, feed_mm_per_s)
        self._await_motion()
        if controller.latch is not None and controller.latch.sequence > before:
            return Touch(_triple(controller.latch.position))
        return Miss(_triple(controller.displayed_position()))

    # ------------------------------------------------------------------ mount

    def mount_at(self, station: int) -> RotaryMount:
        return _MountOfDevice(self, self.world.mount_at(station))

    def home(self) -> None:
        self.orient_to(0.0, 0.0)

    def orient_to(self, azimuth_deg: float, elevation_deg: float) -> Orientation:
        """Turn the mount that holds the artefact, and return the encoder angles after the motion, in degrees."""
        return self.turn(self.world.workpiece.mount, azimuth_deg, elevation_deg)

    def turn(self, mount: MountPhysics, azimuth_deg: float, elevation_deg: float) -> Orientation:
        self._catch_up()
        if not self.world.mounts:
            raise CommandRejected("there is no mount to turn", hint="the artefact is placed by hand")
        mount.begin_turn(AZIMUTH, azimuth_deg)
        mount.begin_turn(ELEVATION, elevation_deg)
        self._sleep_until(lambda: mount.settled_s if mount.settled_s > self.world.now else None)
        if self._controller.motion is MotionState.FAULT:
            raise MotionFault(self._controller.fault, hint="the mount stopped; clear the fault at the machine")
        return self.angles(mount)

    def orientation(self) -> Orientation:
        return self.angles(self.world.workpiece.mount)

    def angles(self, mount: MountPhysics) -> Orientation:
        self._catch_up()
        return Orientation(*mount.angles_deg())

    # ------------------------------------------------------------------ compensation, temperature, operator

    def store_limits(self) -> StoreLimits:
        return self._controller.store_limits

    def active_bank(self) -> int:
        return self._controller.active_bank

    def pending_bank(self) -> int | None:
        """Return None, because an activation in this process takes effect at once."""
        return None

    def read_table(self, bank: int) -> TableImage | None:
        return self._controller.banks.get(bank)

    def stage(self, bank: int, table: TableImage) -> None:
        try:
            self._controller.write_bank(bank, table)
        except CommandRejected as error:
            raise StoreError(error.message, hint=error.hint, bank=bank) from error

    def activate(self, bank: int) -> None:
        try:
            self._controller.activate(bank)
        except CommandRejected as error:
            raise StoreError(error.message, hint=error.hint, bank=bank) from error

    def temperatures_c(self) -> Mapping[str, float]:
        self._catch_up()
        return self._controller.temperatures()

    def ask(self, request: OperatorRequest) -> bool:
        """Move or place the artefact if the request asks for it, and answer yes (True).

        Returns False only if a request to move the artefact names no station.
        """
        if isinstance(request, PlacementRequest) and request.station is not None:
            self._catch_up()
            self.world.place_by_hand(request.station, request.azimuth_deg, request.elevation_deg)
        if request.task is OperatorTask.MOVE_ARTEFACT:
            if request.station is None:
                return False
            self._catch_up()
            self.world.place_artefact(request.station)
        return True

    # ------------------------------------------------------------------ time

    def _catch_up(self) -> None:
        # A clock with interrupts does not count holds, but the machine stands still during them and grows warm or cold.
        self.world.advance_to(without_interrupts(self._clock).now())

    def _await_motion(self) -> None:
        self._sleep_until(self._motion_ends_s)
        controller = self._controller
        if controller.motion is MotionState.FAULT:
            fault = controller.fault
            if fault == GUARD_TRIPPED:
                controller.reset()
                raise GuardTripped(fault, hint="check what the probe touched")
            raise MotionFault(fault, hint="move the probe free, then clear the fault at the machine")

    def _motion_ends_s(self) -> float | None:
        controller = self._controller
        if controller.motion is MotionState.HELD:
            return self.world.now + POLL_S
        return controller.motion_ends_s

    def _sleep_until(self, ends_s: Callable[[], float | None]) -> None:
        """Sleep until `ends_s` returns None instead of an instant; stop all motion if the wait is interrupted."""
        end = ends_s()
        if end is None:
            return
        deadline = Deadline.after(self._clock, end - self.world.now + MOTION_MARGIN_S)
        try:
            while end is not None:
                deadline.raise_if_expired("the end of a motion", hint="is the machine held?")
                self._clock.sleep(end - self.world.now)
                self._catch_up()
                end = ends_s()
        except BaseException:
            self.stop()
            raise


class _MountOfDevice:
    """RotaryMount role for one of the mounts of a `SimulatedMachineDevice`."""

    def __init__(self, device: SimulatedMachineDevice, mount: MountPhysics) -> None:
        self._device = device
        self._mount = mount

    def home(self) -> None:
        self.orient_to(0.0, 0.0)

    def orient_to(self, azimuth_deg: float, elevation_deg: float) -> Orientation:
        return self._device.turn(self._mount, azimuth_deg, elevation_deg)

    def orientation(self) -> Orientation:
        return self._device.angles(self._mount)

    def stop(self) -> None:
        self._device.stop()


def _triple(position: Vector) -> tuple[float, float, float]:
    x, y, z = position.tolist()
    return x, y, z
