"""Temperatures of the machine now, read from its thermometer between two runs."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from agent.errors import Busy
from agent.execution.device_assembly import closing_clock, make_clock, opened_to_look
from agent.execution.rig import in_role
from agent.execution.run_lock import ownership
from agent.settings.schema import Settings
from drivers.errors import CommandRejected
from drivers.registry import DeviceContext, create_device
from drivers.roles import LookOnlyDevice, Thermometer
from twin.monitoring.sensor_screening import plausible_readings

_HINT = "state the temperatures with --temperature"


def read_thermometer(settings: Settings, base: Path) -> dict[str, float]:
    """Return the readings in °C by sensor of the device that is the thermometer according to `settings`. Readings that
    no sensor of a machine gives are left out. `base` is the folder to which paths in the settings refer.

    No other device is opened. This one is opened only to look: nothing moves, and nothing is written. The machine is
    locked meanwhile, since a run must not share its link. Raises Busy if a run or the service owns the machine,
    CommandRejected if the device cannot be read without an effect, and DeviceError if it does not answer.
    """
    name = settings.roles.thermometer
    with _owned(settings), closing_clock(make_clock(settings.clock)) as clock:
        one = settings.devices[name]
        device = create_device(one.driver, one.options, DeviceContext(name, clock, base))
        thermometer = in_role({name: device}, name, Thermometer, "roles.thermometer")
        if not isinstance(device, LookOnlyDevice):
            raise _unread("its driver can open it only as for a run", name)
        if reason := device.why_no_look():
            raise _unread(reason, name)
        with opened_to_look(device):
            return plausible_readings(thermometer.temperatures_c())


@contextmanager
def _owned(settings: Settings) -> Iterator[None]:
    try:
        with ownership(settings.state_directory, "a reading of its thermometer"):
            yield
    except Busy as error:
        raise Busy(error.message, hint=f"wait for it, or {_HINT}", **error.where) from None


def _unread(reason: str, name: str) -> CommandRejected:
    return CommandRejected(f"the thermometer cannot be read: {reason}", hint=_HINT, device=name)
