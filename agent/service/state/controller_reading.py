"""Reading of the controller between two runs: which devices answer, which compensation is active, and what the
thermometer shows."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from agent.execution.device_assembly import opened_to_look
from agent.execution.rig import Rig
from agent.runs.reconcile import reconcile
from agent.runs.reconcile_result import Reconciliation
from agent.service.control import LinkState
from agent.settings.schema import Settings
from drivers.errors import VolcalError
from drivers.roles import LookOnlyDevice, Thermometer
from twin.monitoring.sensor_screening import plausible_readings

NO_LOOK = "its driver can open it only as for a run"


@dataclass(frozen=True)
class ControllerReading:
    """State of the devices and of the compensation when they were last asked.

    `active_bank` is None if the store was not read; `problem` says why it could not be read, and is empty if it was not
    asked because its device cannot be read without an effect. `waiting_bank` becomes active only later. `compared` is
    the comparison with the journal, or None if it was not made again. `temperatures_c` are the readings of the
    thermometer in °C by sensor, none if it was not read.
    """

    links: tuple[LinkState, ...]
    active_bank: int | None = None
    waiting_bank: int | None = None
    problem: str = ""
    compared: Reconciliation | None = None
    temperatures_c: Mapping[str, float] = field(default_factory=dict)


def unreachable(settings: Settings, problem: str) -> ControllerReading:
    """Return the reading if no device can be asked."""
    links = tuple(LinkState(name, problem) for name in settings.devices if name not in _asks_only(settings))
    return ControllerReading(links, problem=problem)


def read_controller(rig: Rig, settings: Settings, must_compare: Callable[[int, int | None], bool]) -> ControllerReading:
    """Open each device of `rig` in turn only to look, read the compensation from the store and the temperatures from
    the thermometer, and close the device again. Nothing moves, and nothing is written. A device that cannot be read
    without an effect is not opened.

    `must_compare` returns True if the active and the waiting bank are to be compared with the journal. The tables are
    read only for this comparison.
    """
    links: list[LinkState] = []
    active: int | None = None
    waiting: int | None = None
    problem, compared = "", None
    temperatures_c: Mapping[str, float] = {}
    roles, asks_only = settings.roles, _asks_only(settings)
    for name, device in rig.devices.items():
        if name in asks_only:
            continue
        seen = device if isinstance(device, LookOnlyDevice) else None
        unread = NO_LOOK if seen is None else seen.why_no_look()
        if seen is None or unread:
            links.append(LinkState(name, unread=unread))
            continue
        try:
            unanswered = ""
            with opened_to_look(seen):
                if name == roles.store:
                    active, waiting = rig.store.active_bank(), rig.store.pending_bank()
                if name == roles.thermometer:
                    temperatures_c, unanswered = _temperatures(rig.thermometer)
            if name == roles.store and active is not None and must_compare(active, waiting):
                with opened_to_look(seen, tables=True):
                    compared = reconcile(rig, settings.state_directory, restore=False)
            links.append(LinkState(name, unanswered))
        except VolcalError as error:
            links.append(LinkState(name, error.message))
            if name == roles.store:
                active, waiting, problem, compared = None, None, error.message, None
    return ControllerReading(tuple(links), active, waiting, problem, compared, temperatures_c)


def _temperatures(thermometer: Thermometer) -> tuple[dict[str, float], str]:
    """Return the readings of the thermometer in °C by sensor, and why there are none. What else its device has
    answered stays known."""
    try:
        return plausible_readings(thermometer.temperatures_c()), ""
    except VolcalError as error:
        return {}, error.message


def _asks_only(settings: Settings) -> set[str]:
    """Return the name of the device through which only a person is asked, if there is one: a person is not a link."""
    roles = settings.roles
    return {roles.operator} - {roles.machine, roles.probe, roles.store, roles.thermometer}
