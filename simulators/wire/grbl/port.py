"""Simulated GRBL controller on a pseudo-terminal, as part of a simulated world."""

from __future__ import annotations

from typing import Final, Protocol

from simulators.wire.grbl.controller import GrblController
from simulators.wire.grbl.dialect import GRBL_11, GrblDialect
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
    """Simulated GRBL or grblHAL controller on a pseudo-terminal. It controls the axes and the probe of the simulated
    world.
    """

    def __init__(
        self,
        shared: SharedWorld[WorldWithAxes],
        link: str = ANY,
        *,
        settings: GrblSettings | None = None,
        dialect: GrblDialect = GRBL_11,
        homed: bool = True,
    ) -> None:
        settings = settings or GrblSettings(shared.world.controller.limits(), dialect=dialect)
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
        """Settings with which the agent's serial driver reaches the controller.

        The settings include the offset between the coordinates of GRBL and those of the world. GRBL homes at the upper
        end of each axis, so its coordinates are negative where those of the world are 0.
        """
        upper = self._shared.world.controller.limits().upper_mm
        return {"port": self.line.device_path, "baud": BAUD, "axis_zero_mm": [-value for value in upper]}

    def _received(self, data: bytes) -> None:
        with self._shared.lock:
            self.controller.received(data)
