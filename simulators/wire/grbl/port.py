"""Simulated GRBL on its pseudo-terminal."""

from __future__ import annotations

from typing import Final, Protocol

from simulators.wire.grbl.controller import GrblController
from simulators.wire.grbl.physics import GrblPhysics
from simulators.wire.grbl.settings import GrblSettings
from simulators.wire.pty_port import ANY, PseudoTerminal
from simulators.wire.shared_world import SharedWorld, TimeDriven

BAUD: Final = 115200
"""Baud rate required by GRBL's documents. It has no effect on a pseudo-terminal."""


class WorldWithAxes(TimeDriven, Protocol):
    @property
    def controller(self) -> GrblPhysics: ...


class GrblPort:
    """Simulated GRBL, controlling the world's axes and probe, on a pseudo-terminal."""

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
        """Settings of the agent's serial driver, which include the offset between GRBL's and the world's coordinates.

        GRBL homes at the upper ends, so it reads negative values where the axes of the world read 0.
        """
        upper = self._shared.world.controller.limits().upper_mm
        return {"port": self.line.device_path, "baud": BAUD, "axis_zero_mm": [-value for value in upper]}

    def _received(self, data: bytes) -> None:
        with self._shared.lock:
            self.controller.received(data)
