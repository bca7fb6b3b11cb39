"""Simulated GRBL on its pseudo-terminal."""

from __future__ import annotations

from typing import Final, Protocol

from simulators.wire.grbl.controller import GrblController
from simulators.wire.grbl.physics import GrblPhysics
from simulators.wire.grbl.settings import GrblSettings
from simulators.wire.pty_port import ANY, PseudoTerminal
from simulators.wire.shared_world import SharedWorld, TimeDriven

BAUD: Final = 115200
"""Baud rate required by GRBL's documents; a pseudo-terminal has none."""


class WorldWithAxes(TimeDriven, Protocol):
    @property
    def controller(self) -> GrblPhysics: ...


class GrblPort:
    """Serves the world's axes and probe on a serial line."""

    def __init__(
        self,
        shared: SharedWorld[WorldWithAxes],
        link: str = ANY,
        *,
        settings: GrblSettings | None = None,
        homed: bool = True,
    ) -> None:
        self._shared = shared
        self.line = PseudoTerminal("grbl", self._received, link)
        self.controller = GrblController(
            shared.world.controller, lambda: shared.now, self.line.send, settings=settings, homed=homed
        )
        shared.subscribe(self.controller.on_advance, wakes_at=self.controller.wakes_at)
        self.start = self.line.start
        self.close = self.line.close

    @property
    def agent_settings(self) -> dict[str, object]:
        """Keys of a serial device's settings. GRBL, homed at the upper ends, reads negative values where the axes read
        0.
        """
        upper = self._shared.world.controller.limits().upper_mm
        return {"port": self.line.device_path, "baud": BAUD, "axis_zero_mm": [-value for value in upper]}

    def _received(self, data: bytes) -> None:
        with self._shared.lock:
            self.controller.received(data)
