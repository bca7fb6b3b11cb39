"""Device for LinuxCNC with the roles `Machine`, `Probe`, `CompensationStore` and `Thermometer`."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress

import numpy as np

from drivers.errors import ConfigurationError, LinkError, LinkLost
from drivers.linuxcnc.bridge_link import BridgeLink
from drivers.linuxcnc.compensation import LinuxCncStore, create_store
from drivers.linuxcnc.diagnosis import diagnose
from drivers.linuxcnc.motion import LinuxCncMotion, MdiMotionKind
from drivers.linuxcnc.probing import LinuxCncProbing
from drivers.linuxcnc.session import LinuxCncSession
from drivers.linuxcnc.settings import LinuxCncSettings
from drivers.linuxcnc.snapshot import ON
from drivers.registry import DeviceContext
from drivers.roles import (
    AxisLimits,
    DiagnosticFinding,
    MachineStatus,
    Miss,
    ProbeStatus,
    StoreLimits,
    TableImage,
    Touch,
    Vector,
)


class LinuxCnc:
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
        self._store = _store(settings, link, context)
        self._parts: _Parts | None = None

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

    def close(self) -> None:
        """Restore the modal codes if motions were made, and end the bridge process.

        The modal codes (G-codes that remain in effect until changed) are those in effect before the first motion; after
        their restoration, the controller is switched to manual mode. Both steps are omitted if the machine is off or
        if LinuxCNC has stopped.
        """
        parts, self._parts = self._parts, None
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

    def home(self) -> None:
        """Home all joints as specified in the INI file; the axes may move."""
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

    def store_limits(self) -> StoreLimits:
        return self._tables.store_limits()

    def active_bank(self) -> int:
        return self._tables.active_bank()

    def pending_bank(self) -> int | None:
        return self._tables.pending_bank()

    def read_table(self, bank: int) -> TableImage | None:
        return self._tables.read_table(bank)

    def stage(self, bank: int, table: TableImage) -> None:
        self._tables.stage(bank, table)

    def activate(self, bank: int) -> None:
        self._tables.activate(bank)

    def temperatures_c(self) -> Mapping[str, float]:
        names = self._session.settings.temperatures
        values = self._session.link.get_all(list(names.values()))
        return {name: float(value) for name, value in zip(names, values, strict=True)}

    @property
    def _open(self) -> _Parts:
        if self._parts is None:
            raise LinkLost("the device is not open", hint="open it first", **self._session.where)
        return self._parts

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
