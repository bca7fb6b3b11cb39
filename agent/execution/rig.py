"""Devices of one machine, together called the rig. Each device has one or more roles, such as machine, probe or
thermometer.

The rig also provides the function that carries out each type of step of a plan.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cached_property
from typing import TypeVar, cast

import numpy as np

from agent.errors import Aborted, MeasurementFault
from agent.execution import steps as s
from agent.execution.engine import Action
from agent.execution.tip_trace import LastMotion
from drivers.clock import Clock, Deadline, without_interrupts
from drivers.errors import (
    CommandRejected,
    ConfigurationError,
    DeviceError,
    MotionFault,
    NotActiveYet,
    PermissionMissing,
    VolcalError,
)
from drivers.roles import (
    Activation,
    AxisHoming,
    CompensationStore,
    Device,
    HoldableMount,
    HomingDirections,
    ImpairableDevice,
    Machine,
    Miss,
    MotionState,
    Operator,
    Orientation,
    Probe,
    RestorableLink,
    RotaryMount,
    StepTracing,
    Thermometer,
    Touch,
)

Role = TypeVar("Role")

ACTIVATED_AFTER = {
    Activation.IMMEDIATE: "the controller has accepted it",
    Activation.RESET: "a reset of the controller",
    Activation.POWER_CYCLE: "the controller has been switched off and on",
    Activation.REFERENCE: "the axes have been referenced",
}
ACTIVATION_INSTRUCTION = {
    Activation.IMMEDIATE: "check the controller",
    Activation.RESET: "reset the controller",
    Activation.POWER_CYCLE: "switch the controller off and on",
    Activation.REFERENCE: "reference the axes",
}

STANDSTILL_WITHIN_S = 10.0
"""Longest wait for standstill; ample, since braking from 20 m/min at 0.5 m/s² takes 0.7 s."""
STANDSTILL_POLL_S = 0.05
PAUSE_S = 2.0
"""Pause in s between two motions after which it is checked that the axes still stand where the first one has ended. A
person needs longer to take over the machine, jog its axes and give it back."""
MOVED_MM = 1.0
"""Largest distance in mm from where the last motion has ended; it is the clearance for which the paths are proved."""


@dataclass
class Rig:
    """Devices of one machine, which are opened, closed and stopped together. `devices` contains all of them by name;
    the fields from `machine` to `operator` contain them by role.

    `mounts` maps the number of each station to the rotary mount that holds the artefact at that station. `store` is the
    device that holds the compensation tables.
    """

    devices: Mapping[str, Device]
    machine: Machine
    probe: Probe
    mounts: Mapping[int, RotaryMount]
    store: CompensationStore
    thermometer: Thermometer
    operator: Operator
    clock: Clock
    last_motion: LastMotion = field(default_factory=LastMotion)
    _open: list[str] = field(default_factory=list)
    _rests_since_s: float = -math.inf

    def open(self) -> None:
        """Open every device.

        If a device cannot be opened, close the devices that are already open and raise the error of the failed device.
        """
        for name, device in self.devices.items():
            try:
                device.open()
            except VolcalError as error:
                self.close()
                raise error.at(device=name) from error.__cause__
            self._open.append(name)

    def close(self) -> list[str]:
        """Close all open devices, in the reverse order of opening.

        Return an error text for each device that could not be closed. No error is raised.
        """
        complaints = []
        while self._open:
            name = self._open.pop()
            try:
                self.devices[name].close()
            except DeviceError as error:
                complaints.append(str(error.at(device=name)))
        return complaints

    def stop(self) -> list[str]:
        """Stop every open device. Return an error text for each device that could not be stopped."""
        complaints = []
        for name in self._open:
            try:
                self.devices[name].stop()
            except DeviceError as error:
                complaints.append(str(error.at(device=name)))
        return complaints

    def hold(self) -> None:
        """Hold the motion in progress, of the axes or of a mount. Called from inside a sleep of the clock."""
        self.machine.hold()
        for mount in self._holdable_mounts:
            mount.hold_turn()

    def resume(self) -> None:
        """Continue a held motion. Called from inside a sleep of the clock."""
        for mount in self._holdable_mounts:
            mount.resume_turn()
        self.machine.resume()

    @property
    def _holdable_mounts(self) -> list[HoldableMount]:
        """Mounts whose turn can be held, each once though it may serve several stations."""
        different = {id(mount): mount for mount in self.mounts.values()}
        return [mount for mount in different.values() if isinstance(mount, HoldableMount)]

    def link_interruptions(self) -> dict[str, int]:
        """Return the number of interruptions of the link from which each device has recovered, by device name."""
        found: dict[str, int] = {}
        for name, one in self._restorable.items():
            with suppress(DeviceError):  # a count must not end a run, nor hide the error that has ended it
                found[name] = one.interruptions()
        return found

    def impairments(self) -> dict[str, list[str]]:
        """Return what is impaired at present in each device that says so, by device name."""
        return {name: one.impairments() for name, one in self._impairable.items()}

    @cached_property
    def _restorable(self) -> Mapping[str, RestorableLink]:
        """Devices with a restorable link, by name. They are asked after every step, and to find out from its methods
        whether a device is one takes longer than to ask it."""
        return {name: one for name, one in self.devices.items() if isinstance(one, RestorableLink)}

    @cached_property
    def _impairable(self) -> Mapping[str, ImpairableDevice]:
        """Devices that say what is impaired, by name; found once, as `_restorable`."""
        return {name: one for name, one in self.devices.items() if isinstance(one, ImpairableDevice)}

    def await_standstill(self, check: Callable[[], None] | None = None) -> None:
        """Wait until the axes of the machine stand still. `check` is called between two looks at the machine, and may
        end the wait by an exception.

        While the axes brake, a controller accepts neither a move nor a resumption nor the activation of another
        compensation table.
        """
        deadline = Deadline.after(self.clock, STANDSTILL_WITHIN_S)
        while self.machine.status().state is MotionState.MOVING:
            if check is not None:
                check()
            deadline.raise_if_expired("standstill after a stop", hint="check the machine before anything else")
            self.clock.sleep(STANDSTILL_POLL_S)

    def actions(self, run: int | None = None) -> dict[type, Action]:
        """Return a mapping from each type of step to the function that carries it out, for use by the engine.

        `run` is the number of the run in the journal. Before each step that moves the axes, every device that can
        display or log the current step receives the tag of the step, a number that `step_tag` computes from the run
        number and the step key. If `run` is None, no tags are sent.
        """
        announce = _announce_nothing if run is None else self._step_announcer(run)

        def move(step: s.MoveTo) -> None:
            announce(step.key)
            self._move(step)

        def retrace(step: s.Retrace) -> None:
            announce(step.of)
            self._move(s.MoveTo(step.of, step.target_mm, step.feed_mm_per_s))

        def touch(step: s.TouchTowards) -> Touch | Miss:
            announce(step.key)
            return self._touch(step)

        def home(step: s.HomeAxes) -> None:
            announce(step.key)
            self._home_axes()

        return {
            s.MoveTo: move,
            s.Retrace: retrace,
            s.TouchTowards: touch,
            s.HomeMount: self._home_mount,
            s.HomeAxes: home,
            s.OrientTo: self._orient,
            s.ReadTemperatures: self._read_temperatures,
            s.ReadClock: lambda _: self.clock.now(),
            s.ReadPosition: self._read_position,
            s.CheckPermissions: self._check_permissions,
            s.ResetFault: lambda _: self.machine.reset(),
            s.CheckProbe: self._check_probe,
            s.AskOperator: self._ask,
            s.Dwell: lambda step: self.clock.sleep(step.duration_s),
            s.Record: lambda _: None,
            s.ReadActiveBank: lambda _: self.store.active_bank(),
            s.AwaitActive: self._await_active,
            s.ReadTable: lambda step: self.store.read_table(step.bank) if step.bank else None,
            s.StageTable: lambda step: self.store.stage(step.bank, step.table),
            s.ActivateBank: self._activate,
        }

    def _step_announcer(self, run: int) -> Callable[[str], None]:
        """Return a function that informs every device with step tracing which step comes next."""
        traced = [device for device in self.devices.values() if isinstance(device, StepTracing)]

        def announce(key: str) -> None:
            tag = step_tag(run, key)
            for device in traced:
                device.trace(tag)

        return announce if traced else _announce_nothing

    def _move(self, step: s.MoveTo) -> None:
        self._require_unmoved()
        self.last_motion.begin(step.target_mm, touch=False)
        with self._faults_told():
            self.machine.move_to(np.array(step.target_mm), feed_mm_per_s=step.feed_mm_per_s, guarded=step.guarded)
        self._end_motion(step.target_mm)

    def _end_motion(self, at: s.Point) -> None:
        self.last_motion.end(at)
        self._rests_since_s = self._now_s()

    def _now_s(self) -> float:
        """Return the time in s, which goes on during a hold of the run."""
        return without_interrupts(self.clock).now()

    def _require_unmoved(self) -> None:
        """Raise MotionFault if the axes do not stand where the last motion has ended, after a pause of the run: on
        hold, while the artefact settled, or while a mount turned.

        Every motion is proved from the end of the one before. From anywhere else, it may lead into the artefact.
        """
        if self._now_s() - self._rests_since_s < PAUSE_S:
            return
        moved_mm = self.last_motion.moved_mm(self.machine.position())
        if moved_mm <= MOVED_MM:
            return
        self.last_motion.forget_stand()  # the withdrawal of the probe begins at the position that it reads itself
        raise MotionFault(
            f"the axes stand {moved_mm:.1f} mm from where their last motion has ended: something else has moved them "
            "since, or the display has changed",
            hint="do not move the axes while a run is in progress, not even on hold; check where they stand, then "
            "continue with `volcal resume`, which first withdraws the probe along the stylus",
        )

    @contextmanager
    def _faults_told(self) -> Iterator[None]:
        """Raise MotionFault if a motion is rejected because the controller is in a fault, such as an emergency stop.

        The rejection itself says nothing about the motion, and a run that was interrupted by a fault can be resumed.
        """
        try:
            yield
        except CommandRejected as rejection:
            status = self.machine.status()
            if status.state is not MotionState.FAULT:
                raise
            raise MotionFault(
                f"the controller is in a fault: {status.fault or 'it gives no reason'}; {rejection.message}",
                hint="remove the cause and reset the controller, then continue with `volcal resume`",
                **rejection.where,
            ) from rejection

    def why_no_homing(self) -> str:
        """Return the reason why the axes cannot be homed on command, in words; an empty text if they can."""
        if not isinstance(self.machine, AxisHoming):
            return "the driver of the machine has no command that homes the axes"
        return self.machine.why_no_homing()

    def homing_directions(self) -> HomingDirections:
        """Return the direction in which X, Y and Z search their switches in a homing, 1 or -1; 0 if it is not known."""
        return self.machine.homing_directions() if isinstance(self.machine, AxisHoming) else (0, 0, 0)

    def _home_axes(self) -> None:
        reason = self.why_no_homing()
        if reason or not isinstance(self.machine, AxisHoming):
            raise CommandRejected(f"the axes cannot be homed: {reason}", hint="home the machine at its own panel")
        self.last_motion = LastMotion()  # nothing leads back from where the controller leaves the axes
        self.machine.home_axes()

    def _touch(self, step: s.TouchTowards) -> Touch | Miss:
        self._require_unmoved()
        self.last_motion.begin(step.target_mm, touch=True)
        with self._faults_told():
            result = self.probe.touch_towards(np.array(step.target_mm), feed_mm_per_s=step.feed_mm_per_s)
        self._end_motion(result.position_mm)
        return result

    def _home_mount(self, step: s.HomeMount) -> None:
        self._require_unmoved()
        self.mounts[step.station].home()

    def _orient(self, step: s.OrientTo) -> Orientation:
        self._require_unmoved()
        return self.mounts[step.station].orient_to(step.azimuth_deg, step.elevation_deg)

    def _read_position(self, _: s.ReadPosition) -> s.Point:
        x, y, z = self.machine.position().tolist()
        self.last_motion.set_position((x, y, z))
        return x, y, z

    def _read_temperatures(self, step: s.ReadTemperatures) -> dict[str, float]:
        """Return the readings in °C. A thermometer that gives no number, such as one with a broken wire, gives no
        reading."""
        found = {name: value for name, value in self.thermometer.temperatures_c().items() if math.isfinite(value)}
        step.require(found, self.clock.now())
        return found

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

    def _activate(self, step: s.ActivateBank) -> None:
        self.last_motion.forget_stand()
        self.store.activate(step.bank)

    def _await_active(self, step: s.AwaitActive) -> None:
        if self.store.pending_bank() == step.bank:
            event = self.store.store_limits().activation
            raise NotActiveYet(
                f"bank {step.bank} is written and becomes active only after {ACTIVATED_AFTER[event]}",
                hint=f"{ACTIVATION_INSTRUCTION[event]}, then continue with `volcal resume`",
                bank=step.bank,
            )

    def _ask(self, step: s.AskOperator) -> None:
        self.last_motion.forget_line()
        if not self.operator.ask(step.request):
            raise Aborted(f"the operator answered no to: {step.request.text}")


def step_tag(run: int, key: str) -> int:
    """Return the tag of a step, a number by which a controller can display and log the step.

    The tag is the CRC-32 of the text ``RUN/KEY``, made of the run number and the step key. If the CRC-32 is 0, the tag
    is 1.
    """
    return zlib.crc32(f"{run}/{key}".encode()) or 1


def _announce_nothing(_: str) -> None:
    """Inform no device."""


def in_role(devices: Mapping[str, Device], name: str, role: type[Role], key: str) -> Role:
    """Return the device called `name` from `devices` if it has the role `role`, that is, if it implements this
    interface.

    Raises ConfigurationError, which names the settings key `key`, if there is no such device or if the device does not
    have the role.
    """
    if name not in devices:
        raise ConfigurationError(f"no device {name!r}", key=key, hint=f"devices are: {', '.join(sorted(devices))}")
    device = devices[name]
    if not isinstance(device, role):
        raise ConfigurationError(f"device {name!r} cannot play the role {role.__name__}", key=key)
    return cast(Role, device)
