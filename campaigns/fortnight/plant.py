"""The machine of the fortnight on its real links, and what its surroundings do to it.

It runs in the process of whoever plays the fortnight; the service reaches it over Modbus TCP and CAN alone. Every
evening it is another day's machine: the controller was switched off, and has kept its banks.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from agent.execution.encoding import table_digest
from drivers.roles import Permission, TableImage
from simulators.scenario import Scenario
from simulators.wire.wired_machine import Links, WiredMachine
from simulators.world.ageing import scenario_of_night
from simulators.world.world import World

HERE = "127.0.0.1"


class Plant:
    """`station_of` night: where the day shift has put the artefact."""

    def __init__(self, scenario: Scenario, station_of: Callable[[int], int]) -> None:
        settings = scenario.settings.model_copy(update={"noise_by_step": True})
        self._scenario = replace(scenario, settings=settings)
        self._station_of = station_of
        self._links = Links((HERE, 0), (HERE, 0), f"socketcand:{HERE}:0", (HERE, 0))
        self._banks: dict[int, TableImage] = {}
        self._active = 0
        self._night = 0
        self._collisions = 0
        self._machine = self._switched_on()
        self._links = _same_places(self.ready)

    # ------------------------------------------------------------------ what happens to it

    def becomes(self, night: int) -> None:
        """Switched off, and on again as the machine that it is that night."""
        self.switch_off()
        self._night = night
        self._machine = self._switched_on()

    def switch_off(self) -> None:
        controller = self.world.controller
        self._banks, self._active = dict(controller.banks), controller.active_bank
        self._collisions += len(self.world.collisions)
        self._machine.close()

    def power_cycle(self) -> None:
        """The same night; what was cut is whole again."""
        self.becomes(self._night)

    def cut_the_link(self) -> None:
        """Modbus: whoever speaks to the controller is hung up on, and nobody gets through any more."""
        self._machine.modbus.close()

    def permit(self, permission: Permission, given: bool) -> None:
        self.world.controller.granted[permission] = given

    def twin(self) -> Plant:
        """A machine that is the same in everything, on links of its own."""
        other = Plant(self._scenario, self._station_of)
        other.switch_off()
        controller = self.world.controller
        other._banks, other._active, other._night = dict(controller.banks), controller.active_bank, self._night
        other._machine = other._switched_on()
        return other

    # ------------------------------------------------------------------ what only the simulator knows

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
        """Of the table in the bank that acts."""
        image = self.world.controller.banks.get(self.active_bank)
        return None if image is None else table_digest(image)

    @property
    def true_um(self) -> float:
        """Volumetric error with the acting table, aligned."""
        return self.world.truth.true_volumetric_error(self.active_bank)[1]

    @property
    def collisions(self) -> int:
        return self._collisions + len(self.world.collisions)

    @property
    def position(self) -> list[float]:
        """Displayed, mm."""
        return [float(value) for value in self.world.controller.displayed_position()]

    def _switched_on(self) -> WiredMachine:
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


def _same_places(ready: dict[str, object]) -> Links:
    """Where the machine listens for ever: the settings of the service name it."""

    def place(name: str) -> tuple[str, int]:
        found = ready[name]
        assert isinstance(found, dict)
        return str(found["host"]), int(found["port"])

    can = ready["can"]
    assert isinstance(can, dict)
    port = can["options"]["port"]
    return Links(place("modbus"), place("control"), f"socketcand:{HERE}:{port}", place("time"))
