"""Device for LinuxCNC with the roles `Machine`, `Probe`, `CompensationStore` and `Thermometer`.

Touches use the probing command G38.3. The latched position is corrected for the delay between the trip of the probe and
the latching of the position.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress

import numpy as np

from drivers.controller_device import ControllerDevice
from drivers.errors import ConfigurationError, LinkError, PermissionMissing, ProtocolError
from drivers.linuxcnc.bridge_link import BridgeLink
from drivers.linuxcnc.compensation import LinuxCncStore, create_store
from drivers.linuxcnc.diagnosis import diagnose
from drivers.linuxcnc.motion import LinuxCncMotion, LinuxCncMotionResult, MdiMotionKind
from drivers.linuxcnc.session import LinuxCncSession
from drivers.linuxcnc.settings import LinuxCncSettings
from drivers.linuxcnc.snapshot import ON, Snapshot
from drivers.registry import DeviceContext
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
from drivers.straight_move import distance_to_segment_mm, limit_along_direction


class LinuxCnc(ControllerDevice["_Parts"]):
    """Machine controlled by LinuxCNC; motion, probing and compensation tables share one bridge process.

    Motion and probing are possible only while the device is open.
    """

    def __init__(self, settings: LinuxCncSettings, context: DeviceContext) -> None:
        link = BridgeLink(
            settings.bridge_command,
            response_timeout_s=settings.response_timeout_s,
            watchdog_timeout_s=settings.watchdog_timeout_s,
            heartbeat_timeout_s=settings.heartbeat_timeout_s,
            device=context.name,
        )
        self._session = LinuxCncSession(link, context.clock, settings)
        super().__init__(self._session.where)
        self._store = _store(settings, link, context)

    def open(self) -> None:
        """Start the bridge process, and home the joints if this is possible without a motion.

        The joints are homed only if the machine is on, they are not yet homed, the settings allow homing, and every
        joint has an absolute encoder.
        """
        if self._parts is not None:
            return
        try:
            self._session.open()
            self._home_in_place()
        except BaseException:
            self._session.link.close()
            raise
        self._parts = _Parts(self._session)

    def why_no_look(self) -> str:
        return ""

    def open_to_look(self, *, tables: bool = False) -> None:
        """Start a bridge process that reads the status of LinuxCNC and HAL pins, and has no channel for commands.

        It does not read LinuxCNC's messages either, since each can be read only once.
        """
        if self._parts is not None:
            return
        try:
            self._session.open(look_only=True)
        except BaseException:
            self._session.link.close()
            raise
        self._look_only = True

    def close(self) -> None:
        """Restore the modal codes if motions were made, and end the bridge process.

        The modal codes (G-codes that remain in effect until changed) are those in effect before the first motion; after
        their restoration, the controller is switched to manual mode. Both steps are omitted if the machine is off or
        if LinuxCNC has stopped.
        """
        parts, self._parts, self._look_only = self._parts, None, False
        try:
            if parts is not None and self._session.link.connected:
                with suppress(LinkError):  # a LinuxCNC that has stopped has no modes left to restore
                    parts.motion.restore_modes()
        finally:
            self._session.link.close()

    def diagnose(self) -> list[DiagnosticFinding]:
        return diagnose(self._session, self._store)

    @property
    def bridge_pid(self) -> int | None:
        """Process id of the bridge process between volcal and LinuxCNC; None if no bridge process has been started."""
        return self._session.link.pid

    def why_no_homing(self) -> str:
        if self._session.properties.absolute_encoders:
            return "every joint has an absolute encoder (HOME_ABSOLUTE_ENCODER = 2): homing moves nothing"
        return ""

    def homing_directions(self) -> HomingDirections:
        return self._session.properties.homing_directions

    def home_axes(self) -> None:
        """Home all joints as specified in the INI file, also those that are homed already; the axes may move."""
        self._open.motion.require_idle()
        self._session.home()

    def limits(self) -> AxisLimits:
        return self._session.properties.limits

    def status(self) -> MachineStatus:
        snapshot = self._session.read_snapshot()
        return MachineStatus(snapshot.state, self._session.permissions(snapshot), snapshot.fault)

    def position(self) -> Vector:
        return np.array(self._session.read_snapshot().position)

    def move_to(self, target_mm: Vector, *, feed_mm_per_s: float | None, guarded: bool) -> None:
        kind = MdiMotionKind.GUARDED if guarded else MdiMotionKind.POSITIONING
        self._open.motion.run(kind, [float(value) for value in target_mm], feed_mm_per_s)

    def trace(self, tag: int) -> None:
        self._open.motion.tag = tag

    def hold(self) -> None:
        self._session.link.ask("pause")

    def resume(self) -> None:
        self._session.link.ask("resume")

    def reset(self) -> None:
        """Switch the machine on again after a fault, and release a hold that volcal has set.

        Raises CommandRejected if the emergency stop is active.
        """
        self._open.motion.reset()

    def stop(self) -> None:
        """Stop the motion of the machine; if the bridge process has ended, a new one is started for the stop.

        The method has no effect if the device is closed.
        """
        if self._parts is not None:
            self._parts.motion.stop()

    def probe_status(self) -> ProbeStatus:
        return self._open.probing.status()

    def touch_towards(self, target_mm: Vector, *, feed_mm_per_s: float) -> Touch | Miss:
        return self._open.probing.touch_towards(target_mm, feed_mm_per_s)

    def temperatures_c(self) -> Mapping[str, float]:
        names = self._session.settings.temperatures
        values = self._session.link.get_all(list(names.values()))
        return {name: float(value) for name, value in zip(names, values, strict=True)}

    @property
    def _tables(self) -> LinuxCncStore:
        if self._store is None:
            raise ConfigurationError(
                "no compensation is configured for this LinuxCNC",
                hint="set compensation.method and compensation.directory",
                key="compensation",
                **self._session.where,
            )
        return self._store

    def _home_in_place(self) -> None:
        if self._session.settings.homing != "absolute-encoders" or not self._session.properties.absolute_encoders:
            return
        snapshot = self._session.read_snapshot()
        if snapshot.task_state == ON and not snapshot.homed:
            self._session.home()


def _store(settings: LinuxCncSettings, link: BridgeLink, context: DeviceContext) -> LinuxCncStore | None:
    if settings.compensation is None:
        return None
    return create_store(settings.compensation, link, context.clock, base_path=context.base_path, device=context.name)


class _Parts:
    """Parts of the device that can be created only after LinuxCNC has reported its limits."""

    def __init__(self, session: LinuxCncSession) -> None:
        self.motion = LinuxCncMotion(session)
        self.probing = LinuxCncProbing(session, self.motion)


class LinuxCncProbing:
    """Touches by the probing command G38.3, which raises no alarm if the probe does not trip.

    The field `tripped` of the snapshot of LinuxCNC's state distinguishes a touch from a miss (no trip).
    """

    def __init__(self, session: LinuxCncSession, motion: LinuxCncMotion) -> None:
        self._session = session
        self._motion = motion
        self._repeated = RepeatedLatch(session.settings.latch_tolerance_mm)

    def status(self) -> ProbeStatus:
        snapshot = self._session.read_snapshot()
        loaded, healthy = self._loaded(snapshot), self._session.probe_healthy(snapshot)
        detail = "" if loaded else f"tool {snapshot.tool} is in the spindle"
        return ProbeStatus(loaded, healthy, snapshot.deflected, detail if healthy else "not healthy: battery or link")

    def touch_towards(self, target_mm: Vector, feed_mm_per_s: float) -> Touch | Miss:
        self._require_usable()
        target = tuple(float(value) for value in target_mm)
        ended = self._motion.run(MdiMotionKind.TOUCH, target, feed_mm_per_s)
        if not ended.snapshot.tripped:
            return Miss(ended.snapshot.position)
        latched = np.array(ended.snapshot.probed)
        distance_mm = distance_to_segment_mm(latched, np.array(ended.start), np.array(target))
        if distance_mm > self._session.settings.latch_tolerance_mm:
            raise ProtocolError(
                f"latched position {ended.snapshot.probed} is {distance_mm:.3f} mm off the commanded path",
                hint="check whether another program uses LinuxCNC at the same time",
                **self._session.where,
            )
        if complaint := self._repeated.complaint(ended.snapshot.probed, ended.start, target):
            raise ProtocolError(
                complaint,
                hint="check motion.probe-input and the probe's debounce in HAL",
                **self._session.where,
            )
        x, y, z = (latched - self._overshoot(ended, target, feed_mm_per_s)).tolist()
        return Touch((x, y, z))

    def _overshoot(self, ended: LinuxCncMotionResult, target: Sequence[float], feed_mm_per_s: float) -> Vector:
        """Return the travel of the axes from the trip to the latch, shape (3,), mm.

        The delay is that of the probe signal plus the time to the servo cycle that reads it, half a cycle on average.
        Overshoot = direction · v · delay. The speed v is the smallest of the programmed feed times its override, the
        limit of the axes along the path, and √(2 a s): the speed after the distance s from the start at acceleration a.
        """
        properties, settings = self._session.properties, self._session.settings
        path = np.subtract(target, ended.start)
        direction = path / np.linalg.norm(path)
        travelled_mm = math.dist(ended.snapshot.probed, ended.start)
        shares = np.abs(direction).tolist()
        speed = min(
            feed_mm_per_s * ended.snapshot.feed_override,
            limit_along_direction(shares, properties.limits.rapid_mm_per_s),
            math.sqrt(2.0 * limit_along_direction(shares, properties.limits.acceleration_mm_per_s2) * travelled_mm),
        )
        late_s = settings.latch_cycles * properties.servo_period_s + settings.probe_delay_s
        return np.asarray(direction * speed * late_s)

    def _require_usable(self) -> None:
        snapshot = self._session.read_snapshot()
        if not (self._loaded(snapshot) and self._session.probe_healthy(snapshot)):
            raise PermissionMissing(
                f"no healthy probe in the spindle (tool {snapshot.tool})", hint="load the probe", **self._session.where
            )

    def _loaded(self, snapshot: Snapshot) -> bool:
        """Return True if the probe is loaded, or if no tool number is configured for it."""
        expected = self._session.settings.probe_tool
        return expected is None or snapshot.tool == expected
