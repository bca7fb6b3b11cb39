"""The devices of one machine in their roles, and what each step means for them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeVar, cast

import numpy as np

from agent.execution import steps as s
from agent.execution.engine import Action
from drivers.clock import Clock, Deadline
from drivers.errors import (
    Aborted,
    ConfigurationError,
    DeviceError,
    MeasurementFault,
    PermissionMissing,
    VolcalError,
)
from drivers.roles import (
    CompensationStore,
    Device,
    Machine,
    Miss,
    MotionState,
    Operator,
    Orientation,
    Probe,
    RotaryMount,
    Thermometer,
    Touch,
)

Role = TypeVar("Role")

STANDSTILL_WITHIN_S = 10.0
"""Generous: 20 m/min is braked with 0.5 m/s² in 0.7 s."""
STANDSTILL_POLL_S = 0.05


@dataclass
class Rig:
    """Opened together, closed together, stopped together. `mounts`: station → mount."""

    devices: Mapping[str, Device]
    machine: Machine
    probe: Probe
    mounts: Mapping[int, RotaryMount]
    store: CompensationStore
    thermometer: Thermometer
    operator: Operator
    clock: Clock
    _open: list[str] = field(default_factory=list)

    def open(self) -> None:
        """Open every device; the ones already open are closed again when one fails."""
        for name, device in self.devices.items():
            try:
                device.open()
            except VolcalError as error:
                self.close()
                raise error.at(device=name) from error.__cause__
            self._open.append(name)

    def close(self) -> list[str]:
        """Close what is open, the last first; complaints are returned, since nothing else can be done."""
        complaints = []
        while self._open:
            name = self._open.pop()
            try:
                self.devices[name].close()
            except DeviceError as error:
                complaints.append(str(error.at(device=name)))
        return complaints

    def stop(self) -> list[str]:
        """Stop everything that moves. Every device is tried; what could not be stopped is returned."""
        complaints = []
        for name in self._open:
            try:
                self.devices[name].stop()
            except DeviceError as error:
                complaints.append(str(error.at(device=name)))
        return complaints

    def await_standstill(self) -> None:
        """Wait until the axes stand: while they brake a controller takes neither a move nor another bank."""
        deadline = Deadline.after(self.clock, STANDSTILL_WITHIN_S)
        while self.machine.status().state is MotionState.MOVING:
            deadline.require("standstill after a stop", hint="look at the machine before anything else")
            self.clock.sleep(STANDSTILL_POLL_S)

    def actions(self) -> dict[type, Action]:
        """What each type of step has done, for the engine."""
        return {
            s.MoveTo: self._move,
            s.TouchTowards: self._touch,
            s.HomeMount: lambda step: self.mounts[step.station].home(),
            s.OrientTo: self._orient,
            s.ReadTemperatures: lambda _: dict(self.thermometer.temperatures_c()),
            s.ReadClock: lambda _: self.clock.now(),
            s.ReadPosition: self._read_position,
            s.CheckPermissions: self._check_permissions,
            s.ResetFault: lambda _: self.machine.reset(),
            s.CheckProbe: self._check_probe,
            s.AskOperator: self._ask,
            s.Dwell: lambda step: self.clock.sleep(step.duration_s),
            s.Record: lambda _: None,
            s.ReadActiveBank: lambda _: self.store.active_bank(),
            s.ReadTable: lambda step: self.store.read_table(step.bank),
            s.StageTable: lambda step: self.store.stage(step.bank, step.table),
            s.ActivateBank: lambda step: self.store.activate(step.bank),
        }

    def _move(self, step: s.MoveTo) -> None:
        self.machine.move_to(np.array(step.target_mm), feed_mm_per_s=step.feed_mm_per_s, guarded=step.guarded)

    def _touch(self, step: s.TouchTowards) -> Touch | Miss:
        return self.probe.touch_towards(np.array(step.target_mm), feed_mm_per_s=step.feed_mm_per_s)

    def _orient(self, step: s.OrientTo) -> Orientation:
        return self.mounts[step.station].orient_to(step.azimuth_deg, step.elevation_deg)

    def _read_position(self, _: s.ReadPosition) -> s.Point:
        x, y, z = self.machine.position().tolist()
        return x, y, z

    def _check_permissions(self, _: s.CheckPermissions) -> None:
        status = self.machine.status()
        if status.state is MotionState.FAULT:
            raise PermissionMissing(
                f"the machine is in fault: {status.fault}", hint="clear it at the machine, then start again"
            )
        if status.missing:
            names = ", ".join(permission.value for permission in status.missing)
            raise PermissionMissing(f"the machine does not permit motion; missing: {names}")

    def _check_probe(self, _: s.CheckProbe) -> None:
        status = self.probe.probe_status()
        for given, text, hint in (
            (status.loaded, "no probe is loaded", "load the touch probe into the spindle"),
            (status.healthy, "the probe is not healthy", "check battery, receiver and cable"),
            (not status.deflected, "the probe is deflected", "check stylus, wiring and shield; move it free"),
        ):
            if not given:
                raise MeasurementFault(f"{text} {status.detail}".strip(), hint=hint)

    def _ask(self, step: s.AskOperator) -> None:
        if not self.operator.ask(step.request):
            raise Aborted(f"the operator said no to: {step.request.text}")


def in_role(devices: Mapping[str, Device], name: str, role: type[Role], key: str) -> Role:
    """Device `name` in `role`; ConfigurationError naming `key` where it is missing or cannot play it."""
    if name not in devices:
        raise ConfigurationError(f"no device {name!r}", key=key, hint=f"devices are: {', '.join(sorted(devices))}")
    device = devices[name]
    if not isinstance(device, role):
        raise ConfigurationError(f"device {name!r} cannot play the role {role.__name__}", key=key)
    return cast(Role, device)
