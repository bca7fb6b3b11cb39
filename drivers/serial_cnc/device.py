"""Device that gives a GRBL controller the roles Machine, Probe, CompensationStore and Thermometer.

The temperatures are values that a person has read and entered in the settings.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from drivers.clock import Clock
from drivers.controller_device import ControllerDevice
from drivers.errors import CommandRejected, ConfigurationError, DeviceError
from drivers.links.serial_port import LineLink, SerialAddress, SerialPort
from drivers.registry import DeviceContext
from drivers.roles import (
    AxisLimits,
    DiagnosticFinding,
    HomingDirections,
    MachineStatus,
    Miss,
    MotionState,
    ProbeStatus,
    Touch,
    Vector,
)
from drivers.serial_cnc.bank_files import BankFiles
from drivers.serial_cnc.control import MotionControl
from drivers.serial_cnc.controller_settings import ControllerSettings
from drivers.serial_cnc.conversation import Conversation
from drivers.serial_cnc.diagnosis import diagnose
from drivers.serial_cnc.frames import CoordinateFrames
from drivers.serial_cnc.homing import SerialHoming
from drivers.serial_cnc.identity import await_rest, read_identity
from drivers.serial_cnc.motion import SerialMotion
from drivers.serial_cnc.probing import SerialProbing
from drivers.serial_cnc.settings import SerialCncSettings
from drivers.serial_cnc.status_tracker import StatusTracker
from drivers.serial_cnc.store import BankStore

RESTARTS_WHEN_OPENED = "the board may restart when its port is opened; if it does not, set restarts_when_opened = false"


class SerialCnc(ControllerDevice["_Parts"]):
    """Device for a GRBL controller.

    The parts of the device that need the controller's settings exist only while the device is open. If `line` is given,
    it takes the place of the serial port of the settings.
    """

    def __init__(self, settings: SerialCncSettings, context: DeviceContext, line: LineLink | None = None) -> None:
        line = line or SerialPort(SerialAddress(settings.port, settings.baud), device=context.name)
        self._settings = settings
        self._clock = context.clock
        self._conversation = Conversation(line, settings)
        super().__init__(self._conversation.where)
        directory = context.base_path / settings.banks.directory
        self._store = BankStore(settings.banks, BankFiles(directory, self._where), self._where, self._require_rest)
        self._directory = directory

    def open(self) -> None:
        try:
            self._store.open()
            self._conversation.open()
            await_rest(self._conversation, self._clock, self._settings.initial_motion_timeout_s)
            identity = read_identity(self._conversation)
            fatal = identity.settings.fatal()
            if fatal:
                raise ConfigurationError(fatal, hint="`volcal doctor` lists every setting that matters", **self._where)
            tracker = StatusTracker(self._conversation, identity.settings, by_hand=self._settings.manual_referencing)
            tracker.set_work_offset(identity.parameters, identity.modes)
            tracker.read_status()
        except BaseException:
            self._conversation.close()
            raise
        self._parts = _Parts(self._conversation, identity.settings, tracker, self._store, self._clock)

    def why_no_look(self) -> str:
        return RESTARTS_WHEN_OPENED if self._settings.restarts_when_opened else ""

    def open_to_look(self, *, tables: bool = False) -> None:
        """Connect and wait for a status report; nothing but status queries (``?``) is sent. The tables are in files.

        Even ``$$`` and ``$#`` would be lines: they would complete what another program has left half sent. Raises
        CommandRejected if the board restarts when its port is opened.
        """
        if reason := self.why_no_look():
            raise CommandRejected(reason, **self._where)
        restarts = self._conversation.restarts
        try:
            self._store.open()
            self._conversation.open(look_only=True)
            if self._conversation.restarts != restarts:
                raise CommandRejected(
                    "the controller restarted when its port was opened",
                    hint="remove restarts_when_opened = false: the board must not be read between runs",
                    **self._where,
                )
        except BaseException:
            self._conversation.close()
            raise
        self._look_only = True

    def close(self) -> None:
        parts, self._parts, self._look_only = self._parts, None, False
        try:
            if parts is not None and (self._conversation.line.connected or parts.control.stopping):
                parts.control.finish()
        finally:
            self._conversation.close()

    def diagnose(self) -> list[DiagnosticFinding]:
        return diagnose(self._conversation, self._settings, self._store, self._directory)

    def limits(self) -> AxisLimits:
        return self._open.frames.limits

    def status(self) -> MachineStatus:
        status = self._open.control.read_status()
        return MachineStatus(status.state, status.permissions, status.fault)

    def position(self) -> Vector:
        parts = self._open
        return parts.frames.to_displayed(parts.control.read_status().position_mm)

    def move_to(self, target_mm: Vector, *, feed_mm_per_s: float | None, guarded: bool) -> None:
        parts, target = self._open, np.asarray(target_mm, dtype=np.float64)
        parts.frames.require_reachable(target, feed_mm_per_s)
        if guarded:
            parts.probing.move_guarded(target, feed_mm_per_s)
        else:
            parts.motion.move_straight(target, feed_mm_per_s)

    def why_no_homing(self) -> str:
        return "" if self._open.controller_settings.homes else "$22=0: homing is off in the controller"

    def homing_directions(self) -> HomingDirections:
        return self._open.controller_settings.homing_directions

    def home_axes(self) -> None:
        parts = self._open
        if not parts.controller_settings.homes:
            raise CommandRejected(
                self.why_no_homing(), hint="set $22=1 if the machine has homing switches", **self._where
            )
        parts.homing.home()

    def hold(self) -> None:
        self._open.control.hold()

    def resume(self) -> None:
        self._open.control.resume()

    def reset(self) -> None:
        self._open.control.reset()

    def stop(self) -> None:
        """Stop the motion, on a new connection if the present one is lost or stalled. Does nothing if the device is
        closed.
        """
        if self._parts is not None:
            self._parts.control.stop()

    def probe_status(self) -> ProbeStatus:
        """Return the probe status. The controller reports only deflection; the probe is assumed to be loaded and
        healthy.
        """
        return ProbeStatus(loaded=True, healthy=True, deflected=self._open.control.read_status().deflected)

    def touch_towards(self, target_mm: Vector, *, feed_mm_per_s: float) -> Touch | Miss:
        parts, target = self._open, np.asarray(target_mm, dtype=np.float64)
        parts.frames.require_reachable(target, feed_mm_per_s)
        return parts.probing.touch_towards(target, feed_mm_per_s)

    def temperatures_c(self) -> Mapping[str, float]:
        """Return the temperatures entered in the settings, in °C."""
        if not self._settings.declared_temperatures_c:
            raise DeviceError(
                "this controller has no thermometer and no temperature is stated",
                hint="assign the role to another device, or set declared_temperatures_c",
                **self._where,
            )
        return dict(self._settings.declared_temperatures_c)

    @property
    def _tables(self) -> BankStore:
        return self._store

    def _require_rest(self) -> None:
        if self._parts is not None and self._parts.control.read_status().state is MotionState.MOVING:
            raise CommandRejected("a compensation cannot change during a motion", **self._where)


class _Parts:
    """Parts of the device that can be created only after the controller has reported its settings."""

    def __init__(
        self,
        conversation: Conversation,
        controller_settings: ControllerSettings,
        tracker: StatusTracker,
        store: BankStore,
        clock: Clock,
    ) -> None:
        zero = conversation.settings.axis_zero_mm
        self.controller_settings = controller_settings
        self.control = MotionControl(conversation, tracker, clock)
        self.frames = CoordinateFrames(controller_settings.limits(zero), zero, store, conversation.where)
        self.motion = SerialMotion(conversation, tracker, self.control, self.frames, clock)
        self.homing = SerialHoming(conversation, tracker, self.control, clock)
        self.probing = SerialProbing(conversation, tracker, self.motion, self.frames, controller_settings)
