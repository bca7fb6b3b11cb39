"""Complete simulated machine with its communication links: one simulated world, all servers that give access to it, and
its source of time.
"""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Any

from drivers.clock import RealClock, ScaledClock
from drivers.errors import ConfigurationError, InputError
from simulators.scenario import Scenario
from simulators.wire.can.mounts import CanMounts, drive_configs
from simulators.wire.control_channel import ControlServer
from simulators.wire.grbl.dialect import GRBL_11, GrblDialect
from simulators.wire.grbl.port import GrblPort
from simulators.wire.instrument_requests import VirtualInstruments
from simulators.wire.modbus.controller import ModbusController
from simulators.wire.modbus.numbers import Float64Numbers, RegisterNumberFormat
from simulators.wire.modbus.rtu import LineSettings, ModbusRtuController
from simulators.wire.shared_world import SharedWorld
from simulators.wire.time_server import Ticker, TimeServer
from simulators.world.world import World

Address = tuple[str, int]


@dataclass(frozen=True)
class Links:
    """Addresses at which the simulated machine listens.

    `speed` is the number of machine seconds per second of the wall clock. If `speed` is None, the agent advances time
    in lockstep (machine time passes only when the agent requests it) over the address `time`. If `modbus_rtu` is given,
    the controller listens only on the serial line that `modbus_rtu` describes, and not on TCP, because the controller
    accepts only one Modbus master.
    """

    modbus: Address
    control: Address
    can: str | None = None
    time: Address = ("127.0.0.1", 0)
    speed: float | None = None
    numbers: RegisterNumberFormat = field(default_factory=Float64Numbers)
    modbus_rtu: LineSettings | None = None
    serial: str | None = None
    """Path of a link to be made to the pseudo-terminal of an additional GRBL, or ``any`` for no link."""
    dialect: GrblDialect = GRBL_11
    """Firmware of the additional GRBL."""


class WiredMachine:
    """Simulated machine with its links to the agent.

    The constructor opens all links, `start` begins to serve them, and `close` ends all servers. Raises
    ConfigurationError if a link is not available or if the scenario does not fit the controller's map of Modbus
    registers.
    """

    def __init__(self, scenario: Scenario, links: Links) -> None:
        self.world = World(scenario)
        self._shared = SharedWorld(self.world)
        self._can: CanMounts | None = None
        self._servers: list[
            ModbusController | ModbusRtuController | ControlServer | GrblPort | TimeServer | Ticker | CanMounts
        ] = []
        with ExitStack() as undo:
            undo.callback(self.close)
            self.modbus = self._controller(links)
            self._servers.append(self.modbus)
            instruments = VirtualInstruments(self._shared)
            self.control = ControlServer(self._shared, links.control, self._fail_drive, instruments.measure)
            self._servers.append(self.control)
            if links.can is not None:
                if not self.world.mounts:
                    raise ConfigurationError(
                        "the artefact of this scenario is placed by hand: there is no mount on a CAN bus",
                        key="placed_by_hand",
                        hint="start the simulator without --can",
                    )
                self._can = CanMounts(links.can, tuple(self.world.mounts.values()), self._shared.lock)
                self._servers.append(self._can)
                self._shared.subscribe(self._can.advance)
            self.serial = _grbl(self._shared, links)
            if self.serial is not None:
                self._servers.append(self.serial)
            self.time = TimeServer(self._shared, links.time) if links.speed is None else None
            self._servers.append(self.time or Ticker(self._shared, _clock(links.speed)))
            undo.pop_all()

    def _controller(self, links: Links) -> ModbusController | ModbusRtuController:
        if links.modbus_rtu is None:
            return ModbusController(self._shared, links.modbus, links.numbers)
        clock = None if links.speed is None else _clock(links.speed)
        return ModbusRtuController(self._shared, links.modbus_rtu, links.numbers, clock)

    def _fail_drive(self, node_id: int, fault: str) -> None:
        if self._can is None:
            raise InputError("no mount is connected to a CAN bus", hint="start the simulator with --can")
        self._can.fail(node_id, fault)

    def start(self) -> None:
        for server in self._servers:
            server.start()

    def close(self) -> None:
        """Close all servers. The source of machine time is closed first, because otherwise a server could still send on
        a closed link.
        """
        while self._servers:
            self._servers.pop().close()

    def ready_line(self) -> dict[str, Any]:
        """Return everything that the agent must know: the actual addresses of the links, the places of the stations,
        and the drives on the CAN bus.

        The value ``can_nodes`` maps each axis of the first mount to the CAN node number of its drive. The value
        ``can_mounts`` contains such a mapping for the number of each mount. If each station has its own mount, the
        number of a mount is the number of its station.
        """
        settings = self.world.scenario.settings
        nodes = [{drive.axis: drive.node_id for drive in drives} for drives in drive_configs(len(self.world.mounts))]
        return {
            "modbus": self.modbus.agent_settings,
            "control": _host_and_port(self.control.address),
            "time": _host_and_port(self.time.address) if self.time is not None else None,
            "can": self._can.agent_settings if self._can is not None else None,
            "can_nodes": nodes[0] if self._can is not None else {},
            "can_mounts": {str(number): pair for number, pair in enumerate(nodes, 1)} if self._can is not None else {},
            "serial": self.serial.agent_settings if self.serial is not None else None,
            "stations": [list(place) for place in settings.stations_mm],
            "standing_at": settings.standing_at,
        }


def _grbl(shared: SharedWorld[World], links: Links) -> GrblPort | None:
    return GrblPort(shared, links.serial, dialect=links.dialect) if links.serial is not None else None


def _clock(speed: float | None) -> RealClock | ScaledClock:
    if speed is None or speed == 1.0:
        return RealClock()
    if not 0.0 < speed <= 1000.0:
        raise ConfigurationError(
            f"the clock cannot run at {speed:g} times real time", hint="use a factor above 0 and at most 1000"
        )
    return ScaledClock(speed)


def _host_and_port(address: Address) -> dict[str, str | int]:
    host, port = address
    return {"host": host, "port": port}
