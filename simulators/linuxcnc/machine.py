"""LinuxCNC and the simulated plant (machine, balls and mount) around it, as one machine in its own Linux namespaces.

The rotary mount has CAN drives. A control channel offers the actions of a person at the machine.
"""

from __future__ import annotations

import shutil
import subprocess
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

from drivers.clock import RealClock, ScaledClock
from drivers.errors import ConfigurationError
from simulators.linuxcnc.instance import LinuxCncInstance
from simulators.linuxcnc.namespaces import make_private
from simulators.linuxcnc.plant import LinuxCncPlant
from simulators.scenario import Scenario
from simulators.wire.can.channel import CanChannel, open_channel
from simulators.wire.can.drive import DriveConfig, drive_node
from simulators.wire.can.mounts import AXES, COUNTS_PER_DEGREE
from simulators.wire.can.server import CanServer
from simulators.wire.control_channel import ControlServer
from simulators.wire.shared_world import SharedWorld
from simulators.wire.time_server import Ticker

OWN_COMPONENTS: Final = Path(__file__).resolve().parent / "components"
CAN: Final = "socketcand:127.0.0.1:29536"
CONTROL: Final = ("127.0.0.1", 5022)
"""Addresses as in config/linuxcnc/volcal.toml.

They can be fixed, because no port is in use in a new network namespace.
"""
BUILD_WITHIN_S: Final = 120.0


def build(components: Path, out: Path) -> list[Path]:
    """Compile the components of the simulated plant and of volcal's LinuxCNC driver for LinuxCNC's hardware abstraction
    layer (HAL), and return the paths of the modules for LinuxCNC to load.

    Raises ConfigurationError if a component does not compile.
    """
    out.mkdir(parents=True, exist_ok=True)
    for source in OWN_COMPONENTS.iterdir():
        shutil.copy(source, out)
    _compile(["halcompile", "--compile", "volcal_plant.comp"], out)
    _compile(["make", "--no-print-directory", "-C", str(components), f"OUT={out}"], out)
    return sorted(out.glob("*.so"))


def _compile(command: list[str], directory: Path) -> None:
    done = subprocess.run(  # noqa: S603  programs of the distribution
        command, cwd=directory, capture_output=True, text=True, timeout=BUILD_WITHIN_S, check=False
    )
    if done.returncode != 0:
        raise ConfigurationError(
            f"a component does not compile: {done.stderr.strip()[-400:]}", hint="install package linuxcnc-uspace-dev"
        )


class LinuxCncMachine:
    """Context manager that runs LinuxCNC and the simulated plant around it. It can be entered once, by a process inside
    the machine's namespaces.

    The directory `work` holds the configuration and the components, and receives all other files.
    """

    def __init__(self, scenario: Scenario, work: Path, ini: str, *, speed: float) -> None:
        self._work = work
        self._speed = speed
        self._ini = ini
        self._scenario = scenario
        self._undo = ExitStack()
        self._can: CanChannel | None = None

    def __enter__(self) -> Self:
        with ExitStack() as undo:
            make_private(self._work, sorted((self._work / "build").glob("*.so")))
            self._plant = LinuxCncPlant(self._scenario, self._work / "plant.bin")
            for server in self._servers():
                undo.callback(server.close)
                server.start()
            undo.enter_context(
                LinuxCncInstance(self._work, self._ini, speed=self._speed, programs=self._work / "build")
            )
            self._undo = undo.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._undo.close()

    def _servers(self) -> list[ControlServer | CanServer | Ticker]:
        shared = SharedWorld(self._plant.world)
        shared.subscribe(self._plant.on_advance)
        self._control = ControlServer(shared, CONTROL)
        self._can = open_channel(CAN)
        nodes = [
            drive_node(DriveConfig(number, axis, COUNTS_PER_DEGREE), mount)[0]
            for mount in self._plant.world.mounts.values()
            for number, axis in enumerate(AXES, start=1)
        ]
        can = CanServer(self._can.bus, nodes, shared.lock)
        shared.subscribe(can.advance)
        clock = RealClock() if self._speed == 1.0 else ScaledClock(self._speed)
        return [self._control, can, Ticker(shared, clock)]

    def ready_line(self) -> dict[str, Any]:
        """Return the addresses of all servers, which are valid inside the machine's namespaces, and the path of the
        log.
        """
        host, port = self._control.address
        return {
            "control": {"host": host, "port": port},
            "can": self._can.agent_settings if self._can is not None else None,
            "log": str(self._work / "linuxcnc.log"),
        }
