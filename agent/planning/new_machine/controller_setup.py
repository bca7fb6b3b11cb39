"""Controller of the machine: its kind, its address, and the options of the driver that connects to it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Self

from drivers.clock import RealClock
from drivers.errors import ConfigurationError
from drivers.roles import AxisLimits, Device, Machine
from twin.errors import DataError

SIMULATED = "simulated"
MODBUS = "modbus-cnc"
SERIAL = "serial-cnc"
LINUXCNC = "linuxcnc"

MODBUS_PORT = 502
SIMULATOR_HOST = "127.0.0.1"
SIMULATOR_PORTS = {"modbus": 5020, "time": 5021, "control": 5022, "can": 29536}
"""Ports at which `volcal simulate` is expected if it is started by hand, as the comments of the settings say."""


@dataclass(frozen=True)
class ControllerSetup:
    """Controller of one of the kinds above.

    `host` and `port` are the address of a Modbus TCP server, `serial_port` is the name of a serial port. They are empty
    and 0 for other kinds.
    """

    kind: str
    host: str = ""
    port: int = 0
    serial_port: str = ""

    @classmethod
    def of(cls, kind: str, address: str | None) -> Self:
        """Return the controller at `address`: HOST or HOST:PORT for Modbus, the name of a port for a serial line.

        Raises DataError if the kind needs an address and none is given, or if it has no address.
        """
        if kind == MODBUS:
            host, _, port = (address or "").partition(":")
            if not host or (port and not port.isdigit()):
                raise DataError(
                    f"controller {kind} needs an address" if not host else f"'{address}' is not HOST:PORT",
                    hint="state --address HOST or --address HOST:PORT of its Modbus TCP server",
                    key="address",
                )
            return cls(kind, host=host, port=int(port or MODBUS_PORT))
        if kind == SERIAL:
            if not address:
                hint = "state --address with its serial port, such as /dev/serial/by-id/…"
                raise DataError(f"controller {kind} needs an address", hint=hint, key="address")
            return cls(kind, serial_port=address)
        if address:
            raise DataError(f"controller {kind} has no address", hint="omit --address", key="address")
        return cls(kind)

    @property
    def driver(self) -> str:
        """Name of the driver plugin."""
        return MODBUS if self.kind == SIMULATED else self.kind

    @property
    def is_simulated(self) -> bool:
        return self.kind == SIMULATED

    def connection_options(self) -> dict[str, str | int]:
        """Return the driver options that are needed to reach the controller."""
        match self.kind:
            case "simulated":
                return {"host": SIMULATOR_HOST, "port": SIMULATOR_PORTS["modbus"]}
            case "modbus-cnc":
                return {"host": self.host, "port": self.port}
            case "serial-cnc":
                return {"port": self.serial_port}
            case _:
                return {}

    def open(self, directory: Path) -> tuple[Device, AxisLimits]:
        """Connect to the controller of the machine in `directory`, and return the open device with the travel and the
        dynamics that it reports. Nothing is moved or written.

        Raises DeviceError if it cannot be reached, and ConfigurationError if its driver is not a machine.
        """
        # The list of drivers is slow to import, and the help text of the set-up needs only the kinds of controller.
        from drivers.registry import DeviceContext, create_device  # noqa: PLC0415

        device = create_device(self.driver, self.connection_options(), DeviceContext("cnc", RealClock(), directory))
        try:
            device.open()
            if not isinstance(device, Machine):
                raise ConfigurationError(f"driver {self.driver} is not a machine", key="controller")
            return device, device.limits()
        except BaseException:
            device.close()
            raise
