"""Addresses of CAN buses, and bus classes of python-can that are extended to avoid defects of this library.

Defects of python-can 4.6 that this module avoids:

* The ``socketcand`` client repeats a refused connection for ten seconds without a pause. Therefore a connection
  with a time limit is tried first. If the server closes the connection, the client reads empty data in an endless
  loop. Therefore the end of the stream is checked before each read.
* The ``slcan`` interface reads its serial port byte by byte and is too slow for a burst of frames. It ignores
  refusals (BELL characters) of the adapter. It writes without a time limit, so an adapter that accepts no bytes
  blocks the caller.
"""

from __future__ import annotations

import contextlib
import fcntl
import io
import os
import select
import socket
import threading
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, cast

import can
from can.interfaces.slcan import slcanBus
from can.interfaces.socketcand import SocketCanDaemonBus

from drivers.address_filter import filter_hint
from drivers.clock import wall_seconds
from drivers.errors import ConfigurationError, LinkLost
from drivers.foreign_errors import OurWords, cause_of

Option = str | int | float | bool

ECHOING_INTERFACES = frozenset({"udp_multicast"})
"""python-can interfaces on which a bus receives its own frames regardless of ``receive_own_messages``."""
CONNECT_WITHIN_S = 3.0
SEND_WITHIN_S = 1.0
"""Longest time in s for sending; a serial adapter that accepts no bytes for so long counts as dead."""
FLAGS_WITHIN_S = 1.0
"""Time limit in s for the answer to a status query; some adapters do not support the query."""


class UnsuitableOption(OurWords, ValueError):
    """Option that the adapter does not have."""


class BusFailure(OurWords, can.CanOperationError):
    """Failure of the bus that is found here and not in python-can."""


@dataclass(frozen=True)
class CanAddress:
    """Address of a CAN bus: the interface, the channel and the options of python-can."""

    interface: str
    channel: str
    options: tuple[tuple[str, Option], ...] = ()

    @classmethod
    def of(cls, interface: str, channel: str, options: Mapping[str, Option]) -> CanAddress:
        return cls(interface, channel, tuple(sorted(options.items())))

    @property
    def name(self) -> str:
        """Name of the CAN bus in messages, for example ``socketcand:can0@127.0.0.1:29536``."""
        options = dict(self.options)
        host = f"@{options['host']}" if "host" in options else ""
        port = f":{options['port']}" if "port" in options else ""
        return f"{self.interface}:{self.channel}{host}{port}"


class SocketcandBus(SocketCanDaemonBus):
    """Socketcand client of python-can, extended to detect that the server has closed the connection."""

    _SocketCanDaemonBus__socket: socket.socket
    _SocketCanDaemonBus__message_buffer: deque[can.Message]

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        stream = self._SocketCanDaemonBus__socket
        if not self._SocketCanDaemonBus__message_buffer:
            readable, _, _ = select.select([stream], [], [], timeout)
            if not readable:
                return None, False
            if not stream.recv(1, socket.MSG_PEEK):
                raise BusFailure("the socketcand server closed the connection")
        message, filtered = super()._recv_internal(0.0)  # type: ignore[no-untyped-call]
        return message, filtered


STATUS_FLAGS = {
    0: "receive queue full",
    1: "transmit queue full",
    2: "error warning",
    3: "data overrun",
    5: "error passive",
    6: "arbitration lost",
    7: "bus error",
}
"""Texts of the bits in the answer to the status command ``F``, by bit number (CAN232 manual of LAWICEL)."""


class SlcanBus(slcanBus):
    """Bus of python-can for serial-line CAN adapters.

    It is extended to read bursts of frames fast enough and to evaluate the status flags of the adapter.
    """

    def __init__(self, channel: str, **options: Any) -> None:
        self._is_shutdown = True
        if options.get("bitrate") not in (None, *self._BITRATES):
            raise UnsuitableOption(
                f"bitrate {options['bitrate']} is not one of {', '.join(str(rate) for rate in self._BITRATES)}"
            )
        self._is_shutdown = False
        self._writing = threading.Lock()
        self._answered = threading.Event()
        self._flags = 0
        self.refusals = 0
        with contextlib.ExitStack() as undo:
            undo.callback(setattr, self, "_is_shutdown", True)
            self._claim = undo.enter_context(_lock_port(channel.partition("@")[0]))
            super().__init__(channel, **options)
            undo.pop_all()
        self.serialPortOrig.write_timeout = SEND_WITHIN_S
        self._discard_opening_refusal()

    def _discard_opening_refusal(self) -> None:
        """Discard the refusal that the adapter sends because python-can opens the channel twice."""
        self._write("F")
        ends_s = wall_seconds() + FLAGS_WITHIN_S
        while not self._answered.is_set() and self._read(max(0.0, ends_s - wall_seconds())) is not None:
            continue
        self.refusals = 0

    def shutdown(self) -> None:
        if self._is_shutdown:
            return
        try:
            super().shutdown()
        except can.CanOperationError:  # the adapter has gone, but its serial port must still be closed here
            self.serialPortOrig.close()
            raise
        finally:
            self._claim.close()

    def status_flags(self, within_s: float) -> int | None:
        """Query the status flags of the adapter and return them; None if the adapter does not answer within `within_s`.

        The thread that receives the frames must be running, because it reads the answer.
        """
        self._answered.clear()
        self._write("F")
        return self._flags if self._answered.wait(within_s) else None

    def status_text(self) -> str:
        """Query the status of the adapter and return it as text."""
        flags = self.status_flags(FLAGS_WITHIN_S)
        if flags is None:
            return "the adapter does not answer a status query"
        reported = [text for bit, text in STATUS_FLAGS.items() if flags >> bit & 1]
        return f"the adapter reports {', '.join(reported)}" if reported else "the adapter reports no error"

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        super().send(msg, SEND_WITHIN_S if timeout is None else timeout)

    def _write(self, string: str) -> None:
        with self._writing:
            super()._write(string)

    def _read(self, timeout: float | None) -> str | None:
        """Return the next line, or BELL if the adapter refused a command; None if neither comes within `timeout` s."""
        ends_s = None if timeout is None else wall_seconds() + timeout
        while (line := self._next_buffered_line()) is None:
            left_s = None if ends_s is None else max(0.0, ends_s - wall_seconds())
            if not self._fill(left_s):
                return None
        if line == "\a":
            self.refusals += 1
        elif line.startswith("F") and len(line) == len("Fxx\r"):
            self._flags = int(line[1:3], 16)
            self._answered.set()
        return line

    def _next_buffered_line(self) -> str | None:
        ends = [end for mark in (b"\r", b"\a") if (end := self._buffer.find(mark)) >= 0]
        if not ends:
            return None
        line = self._buffer[: min(ends) + 1].decode("ascii", errors="replace")
        del self._buffer[: min(ends) + 1]
        return line

    def _fill(self, timeout: float | None) -> bool:
        port = self.serialPortOrig
        try:
            readable, _, _ = select.select([port.fileno()], [], [], timeout)
            if readable:
                self._buffer.extend(port.read(max(1, port.in_waiting)))
        except (OSError, TypeError, ValueError) as error:  # pyserial raises OSError, or the others for a closed port
            raise BusFailure(f"the serial port of the adapter is gone: {cause_of(error)}") from error
        return bool(readable)


def _lock_port(port: str) -> io.FileIO:
    """Open the serial port and lock it exclusively; the lock is held until the returned file is closed."""
    held = io.FileIO(os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK), "r+")
    try:
        fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        held.close()
        raise
    return held


def open_bus(address: CanAddress) -> can.BusABC:
    """Open the CAN bus at `address`.

    Raises ConfigurationError if the settings are impossible, and LinkLost if the bus cannot be reached.
    """
    with _translate_errors(address):
        options = dict(address.options)
        if address.interface == "slcan":
            return SlcanBus(address.channel, **options)
        if address.interface != "socketcand":
            return can.Bus(interface=address.interface, channel=address.channel, **cast(dict[str, Any], options))
        endpoint = (str(options["host"]), int(options["port"]))
        socket.create_connection(endpoint, timeout=CONNECT_WITHIN_S).close()
        return SocketcandBus(channel=address.channel, **options)  # type: ignore[no-untyped-call]


@contextlib.contextmanager
def _translate_errors(address: CanAddress) -> Iterator[None]:
    try:
        yield
    except (can.CanInterfaceNotImplementedError, TypeError, ValueError, KeyError, ImportError) as error:
        raise ConfigurationError(
            f"the CAN bus cannot be opened with these settings: {cause_of(error)}",
            link=address.name,
            hint="check interface, channel and options against python-can's list of interfaces",
        ) from error
    except (can.CanError, OSError) as error:
        raise LinkLost(f"cannot open the CAN bus: {cause_of(error)}", link=address.name, hint=_hint(address)) from error


def _hint(address: CanAddress) -> str:
    match address.interface:
        case "slcan":
            return (
                "check that the adapter is plugged in, the name of its serial port, that this user may open it (group"
                " dialout) and that no other program has it open"
            )
        case "udp_multicast":
            return "check that the network interface is up, supports multicast and has a route for 224.0.0.0/4"
        case "socketcand":
            return filter_hint("check that the CAN server is running", str(dict(address.options).get("host", "")))
        case _:
            return "check that the interface exists and is up (ip link)"
