"""Rigs of the contract tests with a running LinuxCNC."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

import numpy as np
from live import REACH_MM, SPEED, Live

from drivers.clock import ScaledClock
from drivers.contract.rig import ContractRig, Interrupt
from drivers.linuxcnc.device import LinuxCnc

OPTIONS = {
    "temperatures": {"artefact": "volcal-plant.temperature-0"},
    "compensation": {"method": "external-offsets", "directory": "tables", "timeout_s": 60.0},
}


class LinuxCncRig(ContractRig):
    """Rig with LinuxCNC, whose stylus points along `stylus`, by default in the direction Y.

    A latch is as fine as a servo cycle, ±2.5 µm at 5 mm/s, plus the resolution of the table.
    """

    start_mm = (1600.0, 0.0, 0.0)
    free_mm = (1723.456, 0.0, 78.9)
    outside_mm = ((4001.1, 0.0, 0.0), (0.0, -1.1, 0.0), (0.0, 0.0, 1e9))
    resolution_mm = 2.6e-3
    stylus: ClassVar[int] = 1
    """Axis along which the ball is touched."""
    away_mm: ClassVar[float] = 0.0
    """Position of that axis at which the tip is clear of the artefact."""
    into: ClassVar[float] = 1.0
    """Direction from the tip into the ball along that axis."""
    reach_mm: ClassVar[float] = REACH_MM

    def __init__(self, live: Live) -> None:
        self._live = live
        self.clock = ScaledClock(SPEED)
        self.interrupt = Interrupt(self.clock)
        self.device: LinuxCnc = live.device(interrupt=self.interrupt.check, **OPTIONS)
        self.machine = self.probe = self.store = self.thermometer = self.device

    @property
    def ball(self) -> np.ndarray:
        return np.array(self._live.balls[5])

    def approach(self) -> np.ndarray:
        ball = self.ball
        self._retreat()
        above = ball.copy()
        above[self.stylus] = self.away_mm
        self.go(above)
        self.go(ball - 25.0 * self._inwards)
        return ball

    def trip_mm(self, target_mm: np.ndarray) -> np.ndarray:
        return target_mm - self.reach_mm * self._inwards

    def leave(self) -> None:
        """Withdraw the tip from the artefact and empty every bank."""
        self._retreat()
        self.store.activate(0)
        with self._live.bystander() as hal:
            for bank in self.store.store_limits().banks:
                Path(self._live.process.work, "tables", f"bank{bank}.table").unlink(missing_ok=True)
                number = int(hal.get("volcal-tables.load-done")) + 1
                hal.set("volcal-tables.load-bank", bank)
                hal.set("volcal-tables.load-sequence", number)
                while hal.get("volcal-tables.load-done") != number:
                    self.clock.sleep(0.01)

    @property
    def _inwards(self) -> np.ndarray:
        return self.into * np.eye(3)[self.stylus]

    def _retreat(self) -> None:
        here = self.machine.position()
        here[self.stylus] = self.away_mm
        self.go(here)
