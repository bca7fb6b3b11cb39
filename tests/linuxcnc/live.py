"""A stock LinuxCNC with an error-free simulated machine around it, and a driver that reaches into its namespaces."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from campaigns.linuxcnc import ANSWER_WITHIN_S
from drivers.clock import Deadline, InterruptibleClock, RealClock, ScaledClock
from drivers.linuxcnc.bridge_link import BridgeLink
from drivers.linuxcnc.device import LinuxCnc
from drivers.registry import DeviceContext, create_device
from simulators.linuxcnc.process import LinuxCncProcess
from simulators.scenario import read_scenario
from simulators.world.world import World

ROOT = Path(__file__).resolve().parents[2]
CONFIG = ROOT / "config"
SPEED = 5.0
TOOL = np.array([0.0, 250.0, 0.0])
PATIENCE = {"response_timeout_s": ANSWER_WITHIN_S, "motion_margin_s": 600.0, "heartbeat_timeout_s": 60.0}
"""Generous time limits, since the computer may be busy with other tests."""
REACH_MM = 15.5
"""Sum of the radii of the ball and the tip."""


@dataclass
class Live:
    """Running LinuxCNC. `balls` are the axis positions that would put the tip at the centre of each ball."""

    process: LinuxCncProcess
    balls: np.ndarray

    def device(self, *, interrupt: Any = lambda: None, **options: Any) -> LinuxCnc:
        """Return a driver that is not yet open."""
        clock = InterruptibleClock(ScaledClock(SPEED), interrupt)
        given = {"bridge_command": self.process.bridge_command, "watchdog_timeout_s": 0.0, **PATIENCE, **options}
        device = create_device("linuxcnc", given, DeviceContext("cnc", clock, self.process.work))
        assert isinstance(device, LinuxCnc)
        return device

    @contextmanager
    def opened(self, **options: Any) -> Iterator[LinuxCnc]:
        device = self.device(**options)
        device.open()
        try:
            yield device
        finally:
            device.close()

    @contextmanager
    def bystander(self, watchdog_timeout_s: float = 0.0) -> Iterator[BridgeLink]:
        """Open the link of another user to the same LinuxCNC."""
        link = BridgeLink(
            self.process.bridge_command,
            response_timeout_s=ANSWER_WITHIN_S,
            watchdog_timeout_s=watchdog_timeout_s,
            heartbeat_timeout_s=60.0,
            device="bystander",
        )
        link.open()
        try:
            yield link
        finally:
            link.close()

    def by_hand(self, *commands: str) -> None:
        """Send commands of the module linuxcnc as an operator's panel would, waiting until each has been accepted."""
        lines = [f"c.{command}; c.wait_complete(5)" for command in commands]
        script = "\n".join(("import linuxcnc", "c = linuxcnc.command()", *lines))
        subprocess.run([*self.process.bridge_command, "-c", script], check=True, capture_output=True, timeout=600.0)


@contextmanager
def running(
    work: Path,
    *,
    scenario: str = "case-study.toml",
    tool_mm: np.ndarray = TOOL,
    configuration: Path = CONFIG / "linuxcnc",
    ini: str = "machine.ini",
) -> Iterator[Live]:
    """Run LinuxCNC with a configuration and an error-free simulated machine around it."""
    work.mkdir(parents=True, exist_ok=True)
    text = (CONFIG / "simulators" / scenario).read_text(encoding="utf-8").replace('"../', f'"{CONFIG}/')
    file = work / "scenario.toml"
    file.write_text(f"ideal = true\n{text}", encoding="utf-8")
    with LinuxCncProcess(
        scenario=file,
        configuration=configuration,
        components=ROOT / "drivers" / "linuxcnc" / "components",
        work=work,
        speed=SPEED,
        ini=ini,
    ) as process:
        standing = World(read_scenario(file)).table.snapshot(0.0)
        yield Live(process, np.array(standing.balls) - tool_mm)


def until(reached: Callable[[], bool]) -> None:
    """Wait until `reached` returns True."""
    deadline = Deadline.after(RealClock(), 600.0)
    while not reached():
        deadline.raise_if_expired("what the test waits for")
        deadline.clock.sleep(0.01)
