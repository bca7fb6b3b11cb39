"""From settings to open-able devices: clocks, plugins, roles. The only place where names become objects."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from agent.execution.steps import Point
from agent.job import Job
from agent.rig import Rig, in_role
from agent.settings import ClockSettings, Settings
from drivers.clock import INTERRUPT_SLICE_S, Clock, LockstepClock, RealClock, ScaledClock, VirtualClock
from drivers.errors import ConfigurationError
from drivers.registry import DeviceContext, create_device
from drivers.roles import (
    CompensationStore,
    Device,
    Machine,
    MountsAtStations,
    Operator,
    Probe,
    RotaryMount,
    Thermometer,
)

LOCKSTEP_SLICE_S = 0.5
"""Against a lockstep simulator a wait is cut only this fine: there machine time passes in jumps anyway."""
REAL_SLICE_S = 0.02
"""By the wall clock: leaves a busy computer time to send STOP within 100 ms of an abort."""


def make_clock(settings: ClockSettings) -> Clock:
    match settings.kind:
        case "real":
            return RealClock()
        case "scaled":
            return ScaledClock(settings.factor)
        case "lockstep":
            try:
                return LockstepClock(settings.host, settings.port)
            except OSError as error:
                raise ConfigurationError(
                    f"no simulator keeps time at {settings.host}:{settings.port}: {error.strerror or error}",
                    key="clock",
                    hint="start `volcal simulate --clock lockstep` first, or use kind = 'real'",
                ) from error


def slice_of(clock: Clock) -> float:
    """Longest machine time in one piece of a wait."""
    match clock:
        case LockstepClock():
            return LOCKSTEP_SLICE_S
        case RealClock():
            return REAL_SLICE_S
        case _:
            return INTERRUPT_SLICE_S


@contextmanager
def closed_after(clock: Clock) -> Iterator[Clock]:
    """`clock` for the block; a connection to a simulator's time server ends with it."""
    try:
        yield clock
    finally:
        if isinstance(clock, LockstepClock):
            clock.close()


def assemble(settings: Settings, clock: Clock, base: Path) -> Rig:
    """The rig of a real or simulated machine; nothing is opened yet. `base`: where relative paths start."""
    devices = {
        name: create_device(device.driver, device.options, DeviceContext(name, clock, base))
        for name, device in settings.devices.items()
    }
    roles = settings.roles
    return Rig(
        devices=devices,
        machine=in_role(devices, roles.machine, Machine, "roles.machine"),
        probe=in_role(devices, roles.probe, Probe, "roles.probe"),
        mounts=_mounts(devices, settings),
        store=in_role(devices, roles.store, CompensationStore, "roles.store"),
        thermometer=in_role(devices, roles.thermometer, Thermometer, "roles.thermometer"),
        operator=in_role(devices, roles.operator, Operator, "roles.operator"),
        clock=clock,
    )


def assemble_rehearsal(job: Job, clock: VirtualClock, start_mm: Point | None) -> Rig:
    """The rig of the dry run: one device of the plugin that `preflight.driver` names plays every role.

    It is given the machine's own files and geometry, and no errors: what is rehearsed is the procedure.
    """
    settings = job.settings
    options: dict[str, object] = {
        "machine": str(settings.machine),
        "artefact": str(settings.artefact),
        "tool": settings.tool,
        "mount": vars(settings.mount),
        "probe": vars(settings.probe),
        "stations_mm": [list(place) for place in settings.stations.places_mm],
        "standing_at": settings.stations.standing_at or 1,
        "mount_behaviour": settings.timing.model_dump(include={"speed_deg_per_s", "acceleration_deg_per_s2"}),
        "ideal": True,
        **_own_at_stations(job),
    }
    if start_mm is not None:
        options["start_mm"] = list(start_mm)
    context = DeviceContext("preflight", clock, settings.machine.parent)
    device = create_device(settings.preflight.driver, options, context)
    devices = {"preflight": device}
    return Rig(
        devices=devices,
        machine=in_role(devices, "preflight", Machine, "preflight.driver"),
        probe=in_role(devices, "preflight", Probe, "preflight.driver"),
        mounts={n: _mount(devices, "preflight", n, "preflight.driver") for n in _stations(settings)},
        store=in_role(devices, "preflight", CompensationStore, "preflight.driver"),
        thermometer=in_role(devices, "preflight", Thermometer, "preflight.driver"),
        operator=in_role(devices, "preflight", Operator, "preflight.driver"),
        clock=clock,
    )


def _own_at_stations(job: Job) -> dict[str, object]:
    """What the simulated machine is told where each station has a mount of its own."""
    change, settings = job.rules.change, job.settings
    if not change.own_mounts:
        return {}
    return {
        "own_mounts": True,
        "artefacts": [str(path) for path in settings.stations.artefacts or ()],
        "mounts_deg": [list(change.parked_deg)] * len(change.own_mounts),
    }


def _mounts(devices: Mapping[str, Device], settings: Settings) -> dict[int, RotaryMount]:
    named = settings.roles.mount
    if isinstance(named, str):
        return {n: _mount(devices, named, n, "roles.mount") for n in _stations(settings)}
    return {n: _mount(devices, named[n], n, f"roles.mount.{n}") for n in _stations(settings)}


def _mount(devices: Mapping[str, Device], name: str, station: int, key: str) -> RotaryMount:
    mount = in_role(devices, name, RotaryMount, key)
    return mount.mount_at(station) if isinstance(mount, MountsAtStations) else mount


def _stations(settings: Settings) -> range:
    return range(1, len(settings.stations.places_mm) + 1)
