"""Device that gives one Modbus controller the roles Machine, Probe, CompensationStore and Thermometer."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from drivers.clock import Clock
from drivers.controller_device import ControllerDevice
from drivers.errors import CommandRejected, DeviceError, ProtocolError
from drivers.modbus_cnc.codes import (
    ACTIVATIONS,
    NO_TEMPERATURE,
    PROBE_DEFLECTED,
    PROBE_HEALTHY,
    PROBE_LOADED,
    CommandCode,
    MotionOutcome,
    fault_text,
)
from drivers.modbus_cnc.diagnosis import diagnose
from drivers.modbus_cnc.link_factory import create_link
from drivers.modbus_cnc.motion import ModbusMotion
from drivers.modbus_cnc.registers import CommandBlock, ControllerLimits, StatusImage, Triple
from drivers.modbus_cnc.session import ModbusSession
from drivers.modbus_cnc.settings import ModbusCncSettings
from drivers.modbus_cnc.store import ModbusStore
from drivers.repeated_latch import RepeatedLatch
from drivers.roles import (
    AxisLimits,
    DiagnosticFinding,
    HomingDirections,
    MachineStatus,
    Miss,
    ProbeStatus,
    Touch,
    Vector,
)
from drivers.straight_move import distance_to_segment_mm

MIN_TRAVEL_MM, MAX_TRAVEL_MM = 1.0, 1e6
MIN_DYNAMICS = 0.1
"""Lowest plausible speed in mm/s and acceleration in mm/s²."""
MIN_RESOLUTION_MM = 1e-9
"""Smallest plausible resolution in mm.

This bound and `MIN_DYNAMICS` reveal a wrong word or byte order, which makes a float64 huge or smaller than 1e-300.
"""
NO_HOMING = "the Modbus register map has no command that homes the axes"
_LATCH_RESULTS = {MotionOutcome.TRIPPED: 1, MotionOutcome.MISSED: 2}


class ModbusCnc(ControllerDevice["_Parts"]):
    """CNC controller that is reached through Modbus registers.

    The parts of the device for motion, probing and the compensation store share one communication session with the
    controller. They exist only while this session is open.
    """

    def __init__(self, settings: ModbusCncSettings, clock: Clock, name: str) -> None:
        self._session = ModbusSession(create_link(settings, clock, name), clock, settings)
        super().__init__(self._session.where)

    def open(self) -> None:
        self._connect(look_only=False)

    def why_no_look(self) -> str:
        return ""

    def open_to_look(self, *, tables: bool = False) -> None:
        self._connect(look_only=True, tables=tables)

    def _connect(self, *, look_only: bool, tables: bool = False) -> None:
        try:
            self._session.open(look_only=look_only, tables=tables)
            limits = self._session.read_limits()
            self._require_sound(limits)
        except DeviceError:
            self._session.close()
            raise
        self._parts, self._look_only = _Parts(self._session, limits), look_only

    def close(self) -> None:
        self._parts, self._look_only = None, False
        self._session.close()

    def diagnose(self) -> list[DiagnosticFinding]:
        return diagnose(self._session)

    def limits(self) -> AxisLimits:
        return self._open.axis_limits

    def status(self) -> MachineStatus:
        status = self._session.status()
        return MachineStatus(status.state, status.permissions, fault_text(status.fault_code))

    def position(self) -> Vector:
        return np.array(self._session.status().position)

    def move_to(self, target_mm: Vector, *, feed_mm_per_s: float | None, guarded: bool) -> None:
        if feed_mm_per_s is None:
            code = CommandCode.GUARDED_RAPID if guarded else CommandCode.MOVE_RAPID
        else:
            code = CommandCode.GUARDED_FEED if guarded else CommandCode.MOVE_FEED
        self._open.motion.run(code, [float(value) for value in target_mm], feed_mm_per_s)

    def why_no_homing(self) -> str:
        return NO_HOMING

    def homing_directions(self) -> HomingDirections:
        return 0, 0, 0

    def home_axes(self) -> None:
        """Raise CommandRejected, because no register can command it."""
        raise CommandRejected(NO_HOMING, hint="home the machine at its own panel", **self._where)

    def trace(self, tag: int) -> None:
        self._open.motion.tag = tag

    def hold(self) -> None:
        """Send the command HOLD.

        Does nothing while a lost link is being restored: no motion is being followed then, and one that the controller
        has nevertheless begun is stopped by its own watchdog.
        """
        if not self._session.reconnection.in_progress:
            self._session.send_urgent(CommandCode.HOLD)

    def resume(self) -> None:
        if not self._session.reconnection.in_progress:
            self._session.send_urgent(CommandCode.RESUME)

    def interruptions(self) -> int:
        return self._session.reconnection.count

    def reset(self) -> None:
        self._session.command(CommandBlock(CommandCode.RESET))

    def stop(self) -> None:
        """Send the command STOP to the controller, over a new connection if the present one is lost or does not answer.
        Does nothing if the device is closed, or open only to look: then none of its commands can be under way.
        """
        if self._parts is not None and not self._look_only:
            self._parts.motion.stop()

    def probe_status(self) -> ProbeStatus:
        return self._open.probing.status()

    def touch_towards(self, target_mm: Vector, *, feed_mm_per_s: float) -> Touch | Miss:
        return self._open.probing.touch_towards(target_mm, feed_mm_per_s)

    def temperatures_c(self) -> Mapping[str, float]:
        status = self._session.status()
        readings = zip(self._session.settings.temperatures, status.temperatures, strict=False)
        named = list(readings)[: status.temperature_count]
        return {name: value / 1000.0 for name, value in named if name and value != NO_TEMPERATURE}

    @property
    def _tables(self) -> ModbusStore:
        return self._open.store

    def _require_sound(self, limits: ControllerLimits) -> None:
        travels = [high - low for low, high in zip(limits.lower, limits.upper, strict=True)]
        numbers = (*limits.lower, *limits.upper, *limits.rapid, *limits.acceleration)
        sound = (
            all(map(math.isfinite, (*numbers, limits.resolution, limits.max_correction)))
            and all(MIN_TRAVEL_MM <= travel <= MAX_TRAVEL_MM for travel in travels)
            and min(*limits.rapid, *limits.acceleration) >= MIN_DYNAMICS
            and (limits.banks == 0 or limits.resolution >= MIN_RESOLUTION_MM)
            and limits.activation in ACTIVATIONS
        )
        if not sound:
            raise ProtocolError(
                f"the controller reports implausible limits: {limits}",
                hint="compare number type, word order and addresses in the configuration with the controller",
                register=self._session.settings.blocks.limits,
                **self._session.where,
            )


class _Parts:
    """Parts of the device that can be created only after the controller has reported its limits."""

    def __init__(self, session: ModbusSession, limits: ControllerLimits) -> None:
        self.axis_limits = AxisLimits(limits.lower, limits.upper, limits.rapid, limits.acceleration)
        self.motion = ModbusMotion(session, self.axis_limits)
        self.probing = ModbusProbing(session, self.motion)
        self.store = ModbusStore(session, limits)


class ModbusProbing:
    """Probing with the controller's touch-trigger probe.

    A latched position is accepted only if it carries the sequence number of the touch command and lies on the path of
    the touch, and if repeated touches do not agree too well.
    """

    def __init__(self, session: ModbusSession, motion: ModbusMotion) -> None:
        self._session = session
        self._motion = motion
        self._repeated = RepeatedLatch(session.settings.latch_tolerance_mm)

    def status(self) -> ProbeStatus:
        bits = self._session.status().probe_bits
        loaded, healthy = bool(bits & PROBE_LOADED), bool(bits & PROBE_HEALTHY)
        detail = "" if loaded and healthy else ("not healthy: battery or link" if loaded else "not loaded")
        return ProbeStatus(loaded, healthy, bool(bits & PROBE_DEFLECTED), detail)

    def touch_towards(self, target_mm: Vector, feed_mm_per_s: float) -> Touch | Miss:
        start, status = self._motion.run(CommandCode.TOUCH, tuple(float(value) for value in target_mm), feed_mm_per_s)
        self._require_own_latch(status)
        if status.outcome is MotionOutcome.MISSED:
            return Miss(status.latched)
        self._require_on_path(status.latched, start, target_mm)
        if complaint := self._repeated.complaint(status.latched, start, target_mm.tolist()):
            raise self._latch_error(complaint)
        return Touch(status.latched)

    def _require_own_latch(self, status: StatusImage) -> None:
        if status.latch_sequence != status.motion_sequence:
            raise self._latch_error(
                f"stale latch: it belongs to touch {status.latch_sequence}, not to touch {status.motion_sequence}"
            )
        if status.latch_result != _LATCH_RESULTS[status.outcome]:
            raise self._latch_error(
                f"touch ended as {status.outcome.name.lower()}, but the latch result is {status.latch_result}"
            )

    def _require_on_path(self, latched: Triple, start: Triple, target_mm: Vector) -> None:
        distance_mm = distance_to_segment_mm(np.array(latched), np.array(start), np.asarray(target_mm, float))
        allowed_mm = self._session.settings.latch_tolerance_mm
        if distance_mm > allowed_mm:
            raise self._latch_error(
                f"latched position {latched} is {distance_mm:.3f} mm off the commanded path (allowed {allowed_mm:g} mm)"
            )

    def _latch_error(self, text: str) -> ProtocolError:
        settings = self._session.settings
        offset = self._session.layouts.status.offset("latch_sequence")
        return ProtocolError(
            text,
            hint="check how the controller latches the position at the trip",
            register=settings.blocks.status + offset,
            **self._session.where,
        )
