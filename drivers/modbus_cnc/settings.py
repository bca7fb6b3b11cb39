"""Settings of a `modbus-cnc` device. The defaults are those of docs/reference/modbus-register-map.md."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from drivers.links.modbus_serial_line import SerialLine
from drivers.options import DriverOptions

STATUS_REGISTERS = 70
LIMITS_REGISTERS = 63
READ_WINDOW_REGISTERS = 122
COMMAND_REGISTERS = 23
DESCRIPTOR_REGISTERS = 34
DATA_WINDOW_REGISTERS = 121
READ_SELECTOR_REGISTERS = 2

TCP_TIMEOUT_S = 0.5
SERIAL_TIMEOUT_S = 0.25
"""Time limit in s for an answer on a serial line; the transmission time is added.

It is short because after a lost answer the next heartbeat must still reach the controller within its watchdog time of
one second.
"""

BROADCAST_UNIT = 0
LAST_SERIAL_UNIT = 247

Address = Annotated[int, Field(ge=0, le=65535)]
Seconds = Annotated[float, Field(gt=0.0, le=3600.0)]


class BlockAddresses(DriverOptions):
    """Address of the first register of each block of the Modbus register map, counted from 0 as in a transmitted
    request.
    """

    status: Address = 1000
    limits: Address = 1100
    read_window: Address = 1200
    command: Address = 2000
    descriptor: Address = 2100
    data_window: Address = 2200
    read_selector: Address = 2400

    def ranges(self) -> dict[str, range]:
        sizes = {
            "status": STATUS_REGISTERS,
            "limits": LIMITS_REGISTERS,
            "read_window": READ_WINDOW_REGISTERS,
            "command": COMMAND_REGISTERS,
            "descriptor": DESCRIPTOR_REGISTERS,
            "data_window": DATA_WINDOW_REGISTERS,
            "read_selector": READ_SELECTOR_REGISTERS,
        }
        return {name: range(first, first + sizes[name]) for name, first in self}

    def writable(self) -> tuple[range, ...]:
        """Return the address ranges of the registers that the driver may write. All other registers are only read."""
        ranges = self.ranges()
        return tuple(ranges[name] for name in ("command", "descriptor", "data_window", "read_selector"))

    def selectors(self) -> tuple[range, ...]:
        """Return the address ranges of the registers that only select what the controller shows."""
        return (self.ranges()["read_selector"],)

    @model_validator(mode="after")
    def _require_disjoint_blocks(self) -> Self:
        ordered = sorted(self.ranges().items(), key=lambda item: item[1].start)
        for (name, block), (other, following) in pairwise(ordered):
            if block.stop > following.start:
                raise ValueError(
                    f"blocks {name} ({block.start} … {block.stop - 1}) and {other} "
                    f"({following.start} … {following.stop - 1}) overlap"
                )
        if ordered[-1][1].stop > 65536:
            raise ValueError(f"block {ordered[-1][0]} does not end before register 65536")
        return self


class ModbusCncSettings(DriverOptions):
    """Settings of driver `modbus-cnc`. The key `host` selects a TCP link, and `serial` selects a serial line (Modbus
    RTU).
    """

    host: str | None = Field(default=None, min_length=1, description="host name or address of the controller")
    port: int = Field(default=502, ge=1, le=65535)
    serial: SerialLine | None = Field(default=None, description="serial line, instead of host and port")
    unit: int = Field(default=1, ge=0, le=255, description="Modbus unit id; 1 to 247 on a serial line")
    timeout_s: float = Field(
        default=TCP_TIMEOUT_S,
        gt=0.0,
        le=10.0,
        description="for an answer; on a serial line, on top of the transmission time",
    )
    retries: int = Field(default=1, ge=0, le=10, description="number of retries of requests that may be sent again")
    reconnect_attempts: int = Field(
        default=5,
        ge=0,
        le=100,
        description="attempts to open a lost connection again while no axis moves; 0: a lost link ends the run",
    )
    reconnect_timeout_s: Seconds = Field(default=30.0, description="time limit of these attempts")
    combined_function: bool = Field(default=True, description="use function 23 (write and read in one)")

    blocks: BlockAddresses = BlockAddresses()
    number_format: Literal["float64", "int32"] = "float64"
    number_scale: float = Field(default=1e-5, gt=0.0, description="unit of an int32 number")
    word_order: Literal["high-first", "low-first"] = "high-first"
    byte_order: Literal["high-first", "low-first"] = Field(
        default="high-first",
        description="byte order within each register of multi-register values; u16 are always high-first",
    )

    poll_interval_s: float = Field(default=0.4, gt=0.0, le=0.5, description="between two status reads during a motion")
    touch_poll_interval_s: float = Field(
        default=0.2, gt=0.0, le=0.5, description="the same during a touch, whose end cannot be predicted"
    )
    fine_poll_interval_s: float = Field(default=0.01, gt=0.0, le=0.5, description="near the end of a wait")
    acknowledge_timeout_s: Seconds = 1.0
    heartbeat_timeout_s: Seconds = 1.0
    motion_margin_s: Seconds = Field(
        default=5.0,
        description="on top of 1.5 times the predicted duration, and the longest standstill after that: the limit is "
        "extended while the axes advance",
    )
    position_tolerance_mm: float = Field(
        default=0.05,
        gt=0.0,
        le=10.0,
        description="largest distance of each axis from its target at the end of a motion",
    )
    max_hold_s: Seconds = Field(default=600.0, description="longest wait for the release of a feed hold at the panel")
    table_timeout_s: Seconds = Field(default=10.0, description="for one step of a table transfer")
    latch_tolerance_mm: float = Field(
        default=1.0, gt=0.0, description="largest distance of a latched position from the commanded path"
    )
    temperatures: tuple[str, ...] = Field(
        default=("artefact", "ambient", "machine"),
        max_length=8,
        description="names in the order of the registers; an empty name marks an unused sensor",
    )

    @model_validator(mode="before")
    @classmethod
    def _serial_timeout(cls, data: Any) -> Any:
        if isinstance(data, dict) and data.get("serial") is not None:
            return {"timeout_s": SERIAL_TIMEOUT_S, **data}
        return data

    @model_validator(mode="after")
    def _one_link(self) -> Self:
        if (self.host is None) == (self.serial is None):
            raise ValueError("set either host (Modbus TCP) or serial (Modbus RTU), not both")
        if self.serial is not None and "port" in self.model_fields_set:
            raise ValueError("port is the TCP port; the serial port is serial.port")
        if self.serial is not None and not BROADCAST_UNIT < self.unit <= LAST_SERIAL_UNIT:
            raise ValueError(
                f"unit {self.unit} is not valid on a serial line: set 1 to {LAST_SERIAL_UNIT} (0 is broadcast)"
            )
        return self

    @model_validator(mode="after")
    def _names_differ(self) -> Self:
        names = [name for name in self.temperatures if name]
        if len(set(names)) != len(names):
            raise ValueError("temperatures: a name occurs twice")
        return self
