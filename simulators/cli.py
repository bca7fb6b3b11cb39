"""Command `volcal simulate`: the simulated machine as a separate process, reached only over its links."""

from __future__ import annotations

import json
import logging
import signal
import sys
import threading
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import click

from drivers.errors import VolcalError
from simulators.wire.grbl.dialect import DIALECTS
from simulators.wire.modbus.numbers import Float64Numbers, RegisterNumberFormat, ScaledInt32Numbers

if TYPE_CHECKING:
    from simulators.wire.modbus.rtu import LineSettings

# The simulated machine and the logging library are imported by the functions that use them; the help needs neither.

FASTEST = 1000.0
BAUDS = (1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200, 230400, 460800, 921600)


def _address(_ctx: click.Context, _param: click.Parameter, value: str) -> tuple[str, int]:
    """Parse HOST:PORT; port 0 selects any free port."""
    host, separator, port = value.rpartition(":")
    if not (separator and host and port.isdecimal() and int(port) < 65536):
        raise click.BadParameter(f"{value!r} is not HOST:PORT, as 127.0.0.1:5020")
    return host, int(port)


def _speed(_ctx: click.Context, _param: click.Parameter, value: str) -> float | None:
    """Return the speed in machine seconds per wall second, or None for lockstep."""
    if value in ("lockstep", "real"):
        return 1.0 if value == "real" else None
    kind, _, factor = value.partition(":")
    return _number(factor if kind == "scaled" else "", value, "lockstep, real, or scaled:F", FASTEST)


def _numbers(_ctx: click.Context, _param: click.Parameter, value: str) -> RegisterNumberFormat:
    kind, _, scale = value.partition(":")
    if value == "float64":
        return Float64Numbers()
    text = (scale or "1e-5") if kind == "int32" else ""
    return ScaledInt32Numbers(_number(text, value, "float64, int32, or int32:SCALE", 1.0))


def _serial_line(_ctx: click.Context, _param: click.Parameter, value: str | None) -> LineSettings | None:
    """Parse ``PATH`` or ``any``, optionally followed by ``@`` and non-default line parameters, as in
    ``any@9600,8N2``.
    """
    from simulators.wire.modbus.rtu import LineSettings  # noqa: PLC0415

    if value is None:
        return None
    place, _, line = value.partition("@")
    baud, _, mode = (line or "19200,8E1").partition(",")
    parity = {"N": "none", "E": "even", "O": "odd"}.get(mode[1:2])
    known = (
        baud.isdecimal() and int(baud) in BAUDS and parity is not None and mode[:1] == "8" and mode[2:] in ("1", "2")
    )
    if not (place and known and parity is not None):
        raise click.BadParameter(f"{value!r} is not PATH, any, or one of them with a line, as any@9600,8N2")
    return LineSettings(place, int(baud), parity, int(mode[2:]))


def _number(text: str, value: str, forms: str, largest: float) -> float:
    """Return the number at the end of an option such as ``scaled:20``."""
    try:
        number = float(text)
    except ValueError:
        number = 0.0
    if not 0.0 < number <= largest:
        raise click.BadParameter(f"{value!r} is not {forms}; a number is above 0 and at most {largest:g}")
    return number


@click.command("simulate")
@click.option("--config", type=click.Path(path_type=Path), required=True, help="Scenario file (TOML).")
@click.option(
    "--modbus",
    callback=_address,
    metavar="HOST:PORT",
    default="127.0.0.1:0",
    show_default=True,
    help="Address of the Modbus TCP server; port 0 selects a free port.",
)
@click.option(
    "--modbus-rtu",
    callback=_serial_line,
    metavar="PATH|any[@BAUD,8P1]",
    help="Modbus RTU on a pseudo-terminal instead of TCP; PATH becomes a link to it.",
)
@click.option("--serial", metavar="PATH|any", help="Also serve GRBL on a pseudo-terminal; PATH becomes a link to it.")
@click.option(
    "--serial-dialect",
    type=click.Choice(list(DIALECTS)),
    default="grbl",
    show_default=True,
    help="Firmware on the serial line: GRBL 1.1 or grblHAL.",
)
@click.option("--can", metavar="CHANNEL", help="CAN bus: socketcand:HOST:PORT, udp_multicast:GROUP:PORT, slcan:PATH …")
@click.option(
    "--control",
    callback=_address,
    metavar="HOST:PORT",
    default="127.0.0.1:0",
    show_default=True,
    help="Address of the control channel (JSON lines).",
)
@click.option(
    "--clock",
    callback=_speed,
    metavar="lockstep|real|scaled:F",
    default="lockstep",
    show_default=True,
    help="Source of machine time.",
)
@click.option(
    "--time",
    "time_",
    callback=_address,
    metavar="HOST:PORT",
    default="127.0.0.1:0",
    help="Address of the time server for lockstep.",
)
@click.option(
    "--numbers",
    callback=_numbers,
    metavar="float64|int32[:SCALE]",
    default="float64",
    show_default=True,
    help="Number format of the Modbus registers.",
)
@click.option("--end-with-stdin", is_flag=True, help="End when standard input closes.")
def simulate(
    *,
    config: Path,
    modbus: tuple[str, int],
    modbus_rtu: LineSettings | None,
    serial: str | None,
    serial_dialect: str,
    can: str | None,
    control: tuple[str, int],
    clock: float | None,
    time_: tuple[str, int],
    numbers: RegisterNumberFormat,
    end_with_stdin: bool,
) -> None:
    """Run the simulated machine on real links until it is stopped.

    The first and only line on standard output is one JSON object with the addresses on which everything listens.
    """
    import structlog  # noqa: PLC0415

    from simulators.scenario import read_scenario  # noqa: PLC0415
    from simulators.wire.wired_machine import Links, WiredMachine  # noqa: PLC0415

    if not structlog.is_configured():
        _log_to_stderr()
    links = Links(
        modbus=modbus,
        control=control,
        can=can,
        time=time_,
        speed=clock,
        numbers=numbers,
        modbus_rtu=modbus_rtu,
        serial=serial,
        dialect=DIALECTS[serial_dialect],
    )
    try:
        machine = WiredMachine(read_scenario(config), links)
    except VolcalError as error:
        click.echo(f"error: {error}", err=True)
        raise SystemExit(error.exit_code) from None
    ending = Shutdown()
    try:
        ending.listen(with_stdin=end_with_stdin)
        machine.start()
        click.echo(json.dumps(machine.ready_line()))
        ending.wait()
    finally:
        machine.close()
    structlog.get_logger().info("simulator stopped", reason=ending.reason)
    raise SystemExit(ending.exit_code)


@dataclass
class Shutdown:
    """Reason for the end of the process, and its exit code. A reason is a signal, closed standard input or a failed
    server.
    """

    reason: str = ""
    exit_code: int = 0
    _asked: threading.Event = field(default_factory=threading.Event)

    def listen(self, *, with_stdin: bool) -> None:
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, lambda received, _frame: self.ask(signal.Signals(received).name))
        threading.excepthook = self._broken
        if with_stdin:
            threading.Thread(target=self._read_stdin, name="stdin", daemon=True).start()

    def ask(self, reason: str, exit_code: int = 0) -> None:
        self.reason, self.exit_code = self.reason or reason, self.exit_code or exit_code
        self._asked.set()

    def wait(self) -> None:
        self._asked.wait()

    def _read_stdin(self) -> None:
        while sys.stdin.buffer.read(4096):
            pass  # the content has no meaning; only the end of the stream counts
        self.ask("standard input closed")

    def _broken(self, problem: threading.ExceptHookArgs) -> None:
        import structlog  # noqa: PLC0415

        thread = problem.thread.name if problem.thread is not None else "?"
        exc_info = (problem.exc_type, problem.exc_value, problem.exc_traceback)
        structlog.get_logger().error("simulator failed", thread=thread, exc_info=exc_info)
        self.ask(f"{thread} failed", exit_code=1)


def _log_to_stderr() -> None:
    import structlog  # noqa: PLC0415

    structlog.configure(
        processors=[
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso"),
            structlog.processors.format_exc_info,
            structlog.processors.KeyValueRenderer(key_order=["timestamp", "level", "event"]),
        ],
        wrapper_class=structlog.make_filtering_bound_logger(logging.INFO),
        logger_factory=structlog.WriteLoggerFactory(file=sys.stderr),
    )


if __name__ == "__main__":
    simulate()
