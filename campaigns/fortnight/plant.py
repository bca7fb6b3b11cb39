"""Machine of the fortnight with its real communication links, and the external influences on the machine.

The simulated machine runs in the process that carries out the fortnight. The service reaches the machine only over
Modbus TCP and CAN. Every evening the machine has the errors to which it has aged by that evening. Its controller has
been switched off and on since the previous evening, but has retained the compensation tables in its memory banks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace

from agent.execution.encoding import table_digest
from drivers.roles import Permission, TableImage
from simulators.scenario import Scenario
from simulators.wire.wired_machine import Links, WiredMachine
from simulators.world.ageing import scenario_of_night
from simulators.world.world import World

HERE = "127.0.0.1"


class FortnightPlant:
    """Simulated machine over several nights.

    The function `station_of` returns the station of the artefact in a given night.
    """

    def __init__(self, scenario: Scenario, station_of: Callable[[int], int]) -> None:
        settings = scenario.settings.model_copy(update={"noise_by_step": True})
        self._scenario = replace(scenario, settings=settings)
        self._station_of = station_of
        self._links = Links((HERE, 0), (HERE, 0), f"socketcand:{HERE}:0", (HERE, 0))
        self._banks: dict[int, TableImage] = {}
        self._active = 0
        self._night = 0
        self._collisions = 0
        self._machine = self._switch_on()
        self._links = _same_addresses(self.ready)

    # ------------------------------------------------------------------ influences

    def switch_to_night(self, night: int) -> None:
        """Switch the machine off and on again, with the errors and the artefact station of `night`.

        The controller retains the compensation tables in its memory banks.
        """
        self.switch_off()
        self._night = night
        self._machine = self._switch_on()

    def switch_off(self) -> None:
        controller = self.world.controller
        self._banks, self._active = dict(controller.banks), controller.active_bank
        self._collisions += len(self.world.collisions)
        self._machine.close()

    def power_cycle(self) -> None:
        """Switch the machine off and on again in the same night. The restart also restores a link that was cut."""
        self.switch_to_night(self._night)

    def cut_link(self) -> None:
        """Cut the Modbus link to the controller: close the connection and accept no new connection."""
        self._machine.modbus.close()

    @contextmanager
    def without_compensation(self) -> Iterator[None]:
        """Deactivate the compensation table. Afterwards it is active again, whatever was written in the meantime."""
        controller = self.world.controller
        bank, banks = controller.active_bank, dict(controller.banks)
        controller.activate(0)
        yield
        controller = self.world.controller  # another one after a restart
        if bank in banks:
            controller.write_bank(bank, banks[bank])
            controller.activate(bank)

    def permit(self, permission: Permission, given: bool) -> None:
        self.world.controller.granted[permission] = given

    def duplicate(self) -> FortnightPlant:
        """Return a machine that is identical to this machine in the same night but has its own links."""
        other = FortnightPlant(self._scenario, self._station_of)
        other.switch_off()
        controller = self.world.controller
        other._banks, other._active, other._night = dict(controller.banks), controller.active_bank, self._night
        other._machine = other._switch_on()
        return other

    # ------------------------------------------------------------------ truth

    @property
    def world(self) -> World:
        return self._machine.world

    @property
    def ready(self) -> dict[str, object]:
        return self._machine.ready_line()

    @property
    def active_bank(self) -> int:
        return self.world.controller.active_bank

    @property
    def active_crc32(self) -> int | None:
        """CRC-32 of the compensation table in the controller's active bank; None if no table is active."""
        image = self.world.controller.banks.get(self.active_bank)
        return None if image is None else table_digest(image)

    @property
    def true_um(self) -> float:
        """True volumetric error in µm with the active compensation table; the best-fitting rigid motion is removed."""
        return self.world.truth.true_volumetric_error(self.active_bank)[1]

    @property
    def collisions(self) -> int:
        return self._collisions + len(self.world.collisions)

    @property
    def position(self) -> list[float]:
        """Displayed axis positions in mm."""
        return [float(value) for value in self.world.controller.displayed_position()]

    def _switch_on(self) -> WiredMachine:
        scenario = scenario_of_night(self._scenario, self._night)
        settings = scenario.settings.model_copy(update={"standing_at": self._station_of(self._night)})
        machine = WiredMachine(replace(scenario, settings=settings), self._links)
        controller = machine.world.controller
        for bank, image in self._banks.items():
            controller.write_bank(bank, image)
        if self._active:
            controller.activate(self._active)
        machine.start()
        return machine


def _same_addresses(ready: dict[str, object]) -> Links:
    """Return links with the addresses in `ready`.

    The machine must use the same addresses after every restart, because the service's settings name them.
    """

    def place(name: str) -> tuple[str, int]:
        found = ready[name]
        assert isinstance(found, dict)
        return str(found["host"]), int(found["port"])

    can = ready["can"]
    assert isinstance(can, dict)
    port = can["options"]["port"]
    return Links(place("modbus"), place("control"), f"socketcand:{HERE}:{port}", place("time"))
