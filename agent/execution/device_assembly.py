"""Construction of the rig and of the clock of the machine from the settings. The settings name the driver of each
device.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from agent.execution.rig import Rig, in_role
from agent.settings.schema import ClockSettings, Settings, StationSettings
from drivers.address_filter import filter_hint
from drivers.clock import INTERRUPT_SLICE_S, Clock, LockstepClock, RealClock, ScaledClock
from drivers.errors import ConfigurationError
from drivers.foreign_errors import cause_of
from drivers.registry import DeviceContext, create_device
from drivers.roles import (
    CompensationStore,
    Device,
    LookOnlyDevice,
    Machine,
    MultiStationMount,
    Operator,
    Probe,
    RotaryMount,
    Thermometer,
)

LOCKSTEP_SLICE_S = 0.5
"""Longest part of a wait between two checks with a lockstep simulator, whose machine time advances in jumps."""
REAL_SLICE_S = 0.02
"""Longest part of a wait between two checks on the wall clock.

It is so short that even a busy computer sends STOP within 100 ms of an abort.
"""


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
                    f"no simulator serves time at {settings.host}:{settings.port}: {cause_of(error)}",
                    key="clock",
                    hint=filter_hint(
                        "start `volcal simulate --clock lockstep` first, or use kind = 'real'", settings.host
                    ),
                ) from error


def longest_wait_s(clock: Clock) -> float:
    """Return the longest time that a wait on `clock` may last before it checks for requests to hold or abort the run. A
    longer wait is divided into parts of this length.

    The result is in s of machine time, that is, of the time that `clock` shows.
    """
    match clock:
        case LockstepClock():
            return LOCKSTEP_SLICE_S
        case RealClock():
            return REAL_SLICE_S
        case _:
            return INTERRUPT_SLICE_S


@contextmanager
def closing_clock(clock: Clock) -> Iterator[Clock]:
    """Yield `clock` and close it at the end of the `with` block.

    Only a lockstep clock has to be closed. Such a clock shows the time of a simulator and is connected to the
    simulator's time server.
    """
    try:
        yield clock
    finally:
        if isinstance(clock, LockstepClock):
            clock.close()


def assemble(settings: Settings, clock: Clock, base: Path) -> Rig:
    """Return the rig of the real or simulated machine described by `settings`. No device is opened yet.

    `base` is the directory to which relative paths in the settings refer.
    """
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


@contextmanager
def opened_to_look(device: LookOnlyDevice, *, tables: bool = False) -> Iterator[None]:
    """Open `device` only to be read during the `with` block, and close it again. With `tables`, its compensation tables
    can be read too."""
    device.open_to_look(tables=tables)
    try:
        yield
    finally:
        device.close()


def _mounts(devices: Mapping[str, Device], settings: Settings) -> dict[int, RotaryMount]:
    named = settings.roles.mount
    if named is None:
        return {}
    if isinstance(named, str):
        return {n: mount_at_station(devices, named, n, "roles.mount") for n in stations_of(settings.stations)}
    return {n: mount_at_station(devices, named[n], n, f"roles.mount.{n}") for n in stations_of(settings.stations)}


def mount_at_station(devices: Mapping[str, Device], name: str, station: int, key: str) -> RotaryMount:
    mount = in_role(devices, name, RotaryMount, key)
    return mount.mount_at(station) if isinstance(mount, MultiStationMount) else mount


def stations_of(stations: StationSettings) -> range:
    """Return the numbers of the stations described by the settings `stations`, counted from 1."""
    return range(1, len(stations.places_mm) + 1)


@dataclass(frozen=True)
class Devices:
    """Pair of functions that create the rig and the clock of a machine from the settings.

    By default, both are created as the settings describe. A test, whose machine already exists, passes functions that
    return the existing rig and clock.
    """

    assemble: Callable[[Settings, Clock, Path], Rig] = assemble
    make_clock: Callable[[ClockSettings], Clock] = make_clock
