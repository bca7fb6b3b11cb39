"""Reading of the controller between two runs: which devices answer, and which compensation is active."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from agent.execution.rig import Rig
from agent.runs.reconcile import reconcile
from agent.runs.reconcile_result import Reconciliation
from agent.service.control import LinkState
from agent.settings.schema import Settings
from drivers.errors import VolcalError
from drivers.roles import Device, LookOnlyDevice


@dataclass(frozen=True)
class ControllerReading:
    """State of the devices and of the compensation when they were last asked.

    `active_bank` is None if the store could not be read; `problem` then says why. `waiting_bank` becomes active only
    later. `compared` is the comparison with the journal, or None if it was not made again.
    """

    links: tuple[LinkState, ...]
    active_bank: int | None = None
    waiting_bank: int | None = None
    problem: str = ""
    compared: Reconciliation | None = None


def unreachable(settings: Settings, problem: str) -> ControllerReading:
    """Return the reading if no device can be asked."""
    links = tuple(LinkState(name, problem) for name in settings.devices if name not in _asks_only(settings))
    return ControllerReading(links, problem=problem)


def read_controller(rig: Rig, settings: Settings, must_compare: Callable[[int, int | None], bool]) -> ControllerReading:
    """Open each device of `rig` in turn, read the compensation from the store, and close the device again. Nothing
    is measured and no table is written.

    A `LookOnlyDevice` is opened so that nothing is written to it; any other driver does what it does whenever it opens
    its device. `must_compare` returns True if the active and the waiting bank are to be compared with the journal. For
    this comparison the store is opened as for a run, since a controller may show a table only if a block is selected.
    """
    links: list[LinkState] = []
    active: int | None = None
    waiting: int | None = None
    problem, compared = "", None
    roles, asks_only = settings.roles, _asks_only(settings)
    for name, device in rig.devices.items():
        if name in asks_only:
            continue
        try:
            with _opened_to_look(device):
                if name == roles.store:
                    active, waiting = rig.store.active_bank(), rig.store.pending_bank()
            if name == roles.store and active is not None and must_compare(active, waiting):
                with _opened(device):
                    compared = reconcile(rig, settings.state_directory, restore=False)
            links.append(LinkState(name))
        except VolcalError as error:
            links.append(LinkState(name, error.message))
            if name == roles.store:
                active, waiting, problem, compared = None, None, error.message, None
    return ControllerReading(tuple(links), active, waiting, problem, compared)


def _asks_only(settings: Settings) -> set[str]:
    """Return the name of the device through which only a person is asked, if there is one: a person is not a link."""
    roles = settings.roles
    return {roles.operator} - {roles.machine, roles.probe, roles.store, roles.thermometer}


@contextmanager
def _opened_to_look(device: Device) -> Iterator[None]:
    if not isinstance(device, LookOnlyDevice):
        with _opened(device):
            yield
        return
    device.open_to_look()
    try:
        yield
    finally:
        device.close()


@contextmanager
def _opened(device: Device) -> Iterator[None]:
    device.open()
    try:
        yield
    finally:
        device.close()
