"""volcal's contract tests with the ACME driver and a simulated controller on a virtual clock."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from acme_controller import WALL_Y, AcmeController

from drivers.clock import InterruptibleClock, VirtualClock
from drivers.contract.motion_contract import MachineContract, ProbeContract
from drivers.contract.rig import ContractRig, Interrupt
from drivers.registry import DeviceContext, create_device


class AcmeRig(ContractRig):
    start_mm = (0.0, 100.0, 0.0)
    free_mm = (30.0, 120.0, 40.0)

    def __init__(self, port: int, clock: VirtualClock) -> None:
        self.interrupt = Interrupt(clock)
        self.clock = InterruptibleClock(clock, self.interrupt.check)
        device = create_device(
            "acme-cnc", {"host": "127.0.0.1", "port": port}, DeviceContext("cnc", self.clock, Path())
        )
        self.device = self.machine = self.probe = device

    def approach(self) -> np.ndarray:
        self.go((200.0, WALL_Y - 10.0, 50.0))
        return np.array([200.0, WALL_Y + 10.0, 50.0])

    def trip_mm(self, target_mm: np.ndarray) -> np.ndarray:
        return np.array([target_mm[0], WALL_Y, target_mm[2]])


@pytest.fixture
def rig() -> Iterator[AcmeRig]:
    controller, clock = AcmeController(), VirtualClock()
    clock.subscribe(controller.advance_to)
    made = AcmeRig(controller.port, clock)
    made.device.open()
    yield made
    made.device.close()
    controller.close()


class TestMachine(MachineContract):
    pass


class TestProbe(ProbeContract):
    pass
