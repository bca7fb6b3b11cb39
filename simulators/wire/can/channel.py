"""CAN bus of the simulated nodes, which is opened from a specification, as given on a command line.

The specification is one word in one of these forms:

========================================  ==============================================================
``socketcand:127.0.0.1:0``                TCP; the server is in this process (port 0: any)
``udp_multicast:239.74.163.2:43113``      UDP multicast, frames stay on this computer (port 0: any)
``slcan:PATH``                            a serial adapter on a pseudo-terminal; PATH is created as a link to it
                                          (``slcan:any``: the name given by the system)
``virtual:NAME``                          inside this process only
``socketcan:can0``                        a kernel CAN interface, real or ``vcan``
========================================  ==============================================================
"""

from __future__ import annotations

import logging
import socket
from dataclasses import dataclass

import can

from drivers.clock import wall_seconds
from drivers.errors import ConfigurationError
from simulators.wire.can.slcan_peer import SlcanPeerBus
from simulators.wire.can.socketcand_server import SocketcandServerBus

logging.getLogger("can").addHandler(logging.NullHandler())  # failures are raised here, not printed to stderr

Option = str | int | float | bool

SOCKETCAND_BUS = "can0"
SLCAN_BIT_RATE = 500_000
MULTICAST_GROUP = "239.74.163.2"
PROBE_IDENTIFIER = 0x1FFFFFF0
"""Identifier of the frame of the multicast self-test.

It is extended, so that no CANopen node takes the frame as its own.
"""
_FORMS = "socketcand:HOST:PORT, udp_multicast:GROUP:PORT, slcan:PATH, slcan:any, virtual:NAME or socketcan:INTERFACE"


@dataclass(frozen=True)
class CanChannel:
    """Connection of the simulator to a CAN bus, and the settings that the agent needs to reach the same bus."""

    bus: can.BusABC
    interface: str
    channel: str
    options: dict[str, Option]

    @property
    def agent_settings(self) -> dict[str, object]:
        """Settings with which the agent's CANopen driver reaches this bus."""
        return {"interface": self.interface, "channel": self.channel, "options": dict(self.options)}


def open_channel(spec: str) -> CanChannel:
    """Open the simulator's end of the bus given by `spec`, in one of the forms listed in the docstring of the module.

    Raises ConfigurationError if `spec` has none of the known forms or the bus is not available.
    """
    kind, _, place = spec.partition(":")
    try:
        if kind == "socketcand":
            return _socketcand(*_host_and_port(spec, place))
        if kind == "udp_multicast":
            return _multicast(*_host_and_port(spec, place))
        if kind == "slcan" and place:
            return _slcan(place)
        if kind in ("virtual", "socketcan") and place:
            return CanChannel(can.Bus(interface=kind, channel=place), kind, place, {})
    except (can.CanError, OSError, OverflowError) as error:
        raise ConfigurationError(
            f"the CAN channel {spec} cannot be opened: {error}",
            key="can",
            hint="check that the port is free and the interface is up; socketcand:127.0.0.1:0 needs neither",
        ) from error
    raise _unknown(spec)


def multicast_works(group: str = MULTICAST_GROUP, *, within_s: float = 0.5) -> bool:
    """Return True if a frame sent to the UDP multicast address `group` is received on this computer within `within_s`
    seconds.
    """
    try:
        port = _free_udp_port()
        with _multicast_bus(group, port) as sender, _multicast_bus(group, port) as receiver:
            sender.send(can.Message(arbitration_id=PROBE_IDENTIFIER, is_extended_id=True))
            return _comes(receiver, within_s)
    except (can.CanError, OSError):
        return False


def _comes(bus: can.BusABC, within_s: float) -> bool:
    ends_s = wall_seconds() + within_s
    while (left_s := ends_s - wall_seconds()) > 0.0:
        message = bus.recv(left_s)
        if message is not None and message.arbitration_id == PROBE_IDENTIFIER:
            return True
    return False


def _socketcand(host: str, port: int) -> CanChannel:
    bus = SocketcandServerBus(SOCKETCAND_BUS, host, port)
    options: dict[str, Option] = {"host": bus.host, "port": bus.port, "tcp_tune": True}
    return CanChannel(bus, "socketcand", SOCKETCAND_BUS, options)


def _slcan(link: str) -> CanChannel:
    """Open a serial adapter.

    The settings include no wait after opening, because the pseudo-terminal is ready at once.
    """
    bus = SlcanPeerBus(link)
    return CanChannel(bus, "slcan", bus.port, {"bitrate": SLCAN_BIT_RATE, "sleep_after_open": 0.0})


def _multicast(group: str, port: int) -> CanChannel:
    port = port or _free_udp_port()
    options: dict[str, Option] = {"port": port, "hop_limit": 0}
    return CanChannel(_multicast_bus(group, port), "udp_multicast", group, options)


def _multicast_bus(group: str, port: int) -> can.BusABC:
    """Open the bus with hop limit 0, so that frames do not leave this computer."""
    return can.Bus(interface="udp_multicast", channel=group, port=port, hop_limit=0)


def _free_udp_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        return int(probe.getsockname()[1])


def _host_and_port(spec: str, place: str) -> tuple[str, int]:
    host, separator, port = place.rpartition(":")
    if not (separator and host and port.isdecimal() and int(port) < 65536):
        raise _unknown(spec)
    return host, int(port)


def _unknown(spec: str) -> ConfigurationError:
    return ConfigurationError(f"{spec!r} is not a CAN channel", key="can", hint=f"write {_FORMS}")
