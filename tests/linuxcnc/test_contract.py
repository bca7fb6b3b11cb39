"""Contract tests of every role with a running stock LinuxCNC."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from live import REACH_MM, SPEED, Live
from requirements import requires_linuxcnc

from drivers.clock import ScaledClock
from drivers.contract.motion_contract import MachineContract, ProbeContract
from drivers.contract.rig import ContractRig, Interrupt
from drivers.contract.store_contract import CompensationStoreContract, ThermometerContract
from drivers.linuxcnc.device import LinuxCnc

OPTIONS = {
    "temperatures": {"artefact": "volcal-plant.temperature-0"},
    "compensation": {"method": "external-offsets", "directory": "tables", "timeout_s": 60.0},
}

pytestmark = [
    requires_linuxcnc,
    pytest.mark.timeout(300),
]


class LinuxCncRig(ContractRig):
    """Rig with LinuxCNC. A latch is as fine as a servo cycle, ±2.5 µm at 5 mm/s, plus the resolution of the table."""

    start_mm = (1600.0, 0.0, 0.0)
    free_mm = (1723.456, 0.0, 78.9)
    outside_mm = ((4001.1, 0.0, 0.0), (0.0, -1.1, 0.0), (0.0, 0.0, 1e9))
    resolution_mm = 2.6e-3

    def __init__(self, live: Live) -> None:
        self._live = live
        self.clock = ScaledClock(SPEED)
        self.interrupt = Interrupt(self.clock)
        self.device: LinuxCnc = live.device(interrupt=self.interrupt.check, **OPTIONS)
        self.machine = self.probe = self.store = self.thermometer = self.device

    def approach(self) -> np.ndarray:
        ball = self._live.balls[5]
        here = self.machine.position()
        self.go((here[0], 0.0, here[2]))
        self.go((ball[0], 0.0, ball[2]))
        self.go(ball - [0.0, 25.0, 0.0])
        return ball

    def trip_mm(self, target_mm: np.ndarray) -> np.ndarray:
        return target_mm - [0.0, REACH_MM, 0.0]

    def leave(self) -> None:
        """Withdraw the tip from the artefact and empty every bank."""
        here = self.machine.position()
        self.go((here[0], 0.0, here[2]))
        self.store.activate(0)
        with self._live.bystander() as hal:
            for bank in self.store.store_limits().banks:
                Path(self._live.process.work, "tables", f"bank{bank}.table").unlink(missing_ok=True)
                number = int(hal.get("volcal-tables.load-done")) + 1
                hal.set("volcal-tables.load-bank", bank)
                hal.set("volcal-tables.load-sequence", number)
                while hal.get("volcal-tables.load-done") != number:
                    self.clock.sleep(0.01)


@pytest.fixture
def rig(live: Live) -> Iterator[LinuxCncRig]:
    made = LinuxCncRig(live)
    made.device.open()
    try:
        yield made
        made.leave()
    finally:
        made.device.close()


class TestMachine(MachineContract):
    pass


class TestProbe(ProbeContract):
    pass


class TestCompensationStore(CompensationStoreContract):
    pass


class TestThermometer(ThermometerContract):
    pass
