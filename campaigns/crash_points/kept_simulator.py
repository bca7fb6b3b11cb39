"""Simulated machine in a process of its own that can be killed. Its banks are kept as in flash memory: a complete bank
survives, and a transfer in progress is lost."""

from __future__ import annotations

import json
import os
import pickle
import signal
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from agent.execution.encoding import table_digest
from agent.files import write_all_atomically
from campaigns.crash_points.death_point import DeathPoint
from campaigns.crash_points.forked_process import ForkedProcess, wait_for
from drivers.roles import TableImage
from simulators.scenario import Scenario
from simulators.wire.modbus.tables import BankRegisters
from simulators.wire.wired_machine import Links, WiredMachine
from simulators.world.world import World

TABLE_COMMANDS = ("begin", "take_block", "commit", "arm", "activate")
BEFORE, AFTER = "before", "after"
PASS = signal.SIGUSR1
"""Signal with which the parent lets machine time pass."""
PASSED_S = 10.0


@dataclass(frozen=True)
class KeptState:
    """State that the simulated machine last kept: the number of the active bank, the CRC-32 of the table in each
    complete bank, and its collisions in words."""

    active: int
    banks: dict[int, int]
    collisions: tuple[str, ...]

    @property
    def table(self) -> tuple[int, int]:
        """Active bank and the CRC-32 of its table, which is 0 without a table."""
        return self.active, self.banks.get(self.active, 0)


class KeptSimulator:
    """Simulated machine of a scenario, and the process that serves it. `former` is the table that is active in bank 1
    before anything has run."""

    def __init__(self, scenario: Scenario, directory: Path, former: TableImage) -> None:
        self.death = DeathPoint()
        self._scenario, self._directory = scenario, directory
        self._flash, self._truth = directory / "flash", directory / "truth.json"
        self._flash.write_bytes(pickle.dumps(({1: former}, 1)))
        self._links = Links(("127.0.0.1", 0), ("127.0.0.1", 0), can="socketcand:127.0.0.1:0")
        self._answered = 0
        self._process: ForkedProcess | None = None
        self.ready: dict[str, Any] = {}

    def start(self) -> None:
        """Start the process; after a kill on the same addresses."""
        told = self._directory / "ready.json"
        told.unlink(missing_ok=True)
        self._process = ForkedProcess(lambda: self._serve(told), self._directory / "simulator.log")
        wait_for(lambda: told.exists() or self.ended, "the simulator")
        if self.ended:
            raise RuntimeError(f"the simulator did not start: {self._process.log.read_text()[-2000:]}")
        self.ready = json.loads(told.read_text())
        can = self.ready["can"]["options"]
        self._links = replace(
            self._links,
            modbus=(self.ready["modbus"]["host"], self.ready["modbus"]["port"]),
            control=(self.ready["control"]["host"], self.ready["control"]["port"]),
            time=(self.ready["time"]["host"], self.ready["time"]["port"]),
            can=f"socketcand:{can['host']}:{can['port']}",
        )

    @property
    def ended(self) -> bool:
        return self._process is not None and self._process.ended

    def kill(self) -> None:
        if self._process is not None:
            self._process.kill()

    def bring_home(self) -> None:
        """Start the machine anew with its axes at their start, as a person does after an interruption in a motion."""
        self.kill()
        self.start()

    def lose_activation(self) -> None:
        """Let the machine, which does not run, start without compensation: its banks are kept, the active one is
        not."""
        banks, _ = pickle.loads(self._flash.read_bytes())  # noqa: S301  our own file
        self._flash.write_bytes(pickle.dumps((banks, 0)))

    def let_time_pass(self) -> None:
        """Let machine time pass, so that a motion ends for want of a heartbeat."""
        assert self._process is not None
        self._answered += 1
        os.kill(self._process.pid, PASS)
        answered = self._answered
        wait_for(lambda: json.loads(self._truth.read_text())["answered"] >= answered, "the machine")

    @property
    def truth(self) -> KeptState:
        document = json.loads(self._truth.read_text())
        banks = {int(bank): crc32 for bank, crc32 in document["banks"].items()}
        return KeptState(document["active"], banks, tuple(document["collisions"]))

    # ------------------------------------------------------------------ in the process of the machine

    def _serve(self, told: Path) -> None:
        machine = WiredMachine(self._scenario, self._links)
        world = machine.world
        banks, active = pickle.loads(self._flash.read_bytes())  # noqa: S301  our own file
        for bank, image in banks.items():
            world.controller.write_bank(bank, image)
        world.controller.activate(active)
        self._keep(world)
        self._watch(world)
        signal.pthread_sigmask(signal.SIG_BLOCK, {PASS})  # before there are threads, which inherit it
        machine.start()
        write_all_atomically(told.parent, {told.name: json.dumps(machine.ready_line())})
        while True:
            signal.sigwait({PASS})
            shared = machine._shared
            with shared.lock:
                shared.advance_to(shared.now + PASSED_S)
                self._answered += 1
                self._keep(world)

    def _watch(self, world: World) -> None:
        """Keep the banks with each change of them, and pass a death point before and after each command."""
        for name in TABLE_COMMANDS:
            setattr(BankRegisters, name, self._watched(world, name, getattr(BankRegisters, name)))
        record = world._record

        def recorded(body_a: str, body_b: str) -> None:
            record(body_a, body_b)
            self._keep(world)

        world._record = recorded  # type: ignore[method-assign]
        world.controller._on_collision = recorded

    def _watched(self, world: World, name: str, real: Callable[..., Any]) -> Callable[..., Any]:
        def command(registers: BankRegisters, *values: Any) -> Any:
            self.death.passed(f"{BEFORE} {name}")
            result = real(registers, *values)
            if name in ("commit", "activate"):
                self._keep(world)
            self.death.passed(f"{AFTER} {name}")
            return result

        return command

    def _keep(self, world: World) -> None:
        controller = world.controller
        kept = pickle.dumps((dict(controller.banks), controller.active_bank))
        banks = {str(bank): table_digest(image) for bank, image in controller.banks.items()}
        collisions = [f"{one.body_a} with {one.body_b}" for one in world.collisions]
        truth = {"answered": self._answered, "active": controller.active_bank, "banks": banks, "collisions": collisions}
        write_all_atomically(self._directory, {self._flash.name: kept, self._truth.name: json.dumps(truth)})
