"""One CANopen network per CAN channel inside this process, shared and counted.

A CAN channel can be opened once per process and carries every node of every mount on it, so devices
that name the same interface, channel and options get the same `canopen.Network`; the last one to close
it shuts the bus.

Peculiarities of python-can 4.6 that are kept in here:

* ``udp_multicast`` hands a bus its own frames back whatever ``receive_own_messages`` says. In CANopen a
  COB-ID has one producer, so a frame with an identifier that we have sent is our own and is dropped.
* the ``socketcand`` client retries a refused connection in a busy loop for ten seconds, and when the server
  goes away it spins on an empty read for ever. The first is answered before it is asked, by a connection
  attempt with a time limit; the second by looking ahead for the end of the stream.
* its notifier thread dies on an exception, or, with a handler, spins on it; so frames are received by a
  thread of our own, which ends quietly at the first failure, and `CanLink.check` tells.
"""

from __future__ import annotations

import contextlib
import logging
import select
import socket
import threading
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, cast

import can
import canopen
from can.interfaces.socketcand import SocketCanDaemonBus
from canopen.objectdictionary import ObjectDictionary

from drivers.errors import ConfigurationError, LinkLost

for _library in ("can", "canopen"):  # what they log as an error is raised as a typed error here
    logging.getLogger(_library).addHandler(logging.NullHandler())

Option = str | int | float | bool

ECHOING_INTERFACES = frozenset({"udp_multicast"})
RECEIVE_CYCLE_S = 0.1
"""Longest wait of the receiving thread for one frame: closing the bus takes up to this long."""
CONNECT_WITHIN_S = 3.0


@dataclass(frozen=True)
class CanAddress:
    """Where a bus is, in python-can's words."""

    interface: str
    channel: str
    options: tuple[tuple[str, Option], ...] = ()

    @classmethod
    def of(cls, interface: str, channel: str, options: Mapping[str, Option]) -> CanAddress:
        return cls(interface, channel, tuple(sorted(options.items())))

    @property
    def name(self) -> str:
        """How messages call the link, for example ``socketcand:can0@127.0.0.1:29536``."""
        options = dict(self.options)
        host = f"@{options['host']}" if "host" in options else ""
        port = f":{options['port']}" if "port" in options else ""
        return f"{self.interface}:{self.channel}{host}{port}"


class _Network(canopen.Network):
    """A network that does not listen to itself where the interface echoes."""

    def __init__(self, bus: can.BusABC, *, drops_own_frames: bool) -> None:
        super().__init__(bus)
        self._drops_own_frames = drops_own_frames
        self._own_identifiers: set[int] = set()

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        self._own_identifiers.add(can_id)
        super().send_message(can_id, data, remote)

    def notify(self, can_id: int, data: bytearray, timestamp: float) -> None:
        if not (self._drops_own_frames and can_id in self._own_identifiers):
            super().notify(can_id, data, timestamp)


class _SocketcandBus(SocketCanDaemonBus):
    """python-can's client, which notices that its server has gone."""

    _SocketCanDaemonBus__socket: socket.socket
    _SocketCanDaemonBus__message_buffer: deque[can.Message]

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        stream = self._SocketCanDaemonBus__socket
        if not self._SocketCanDaemonBus__message_buffer:
            readable, _, _ = select.select([stream], [], [], timeout)
            if not readable:
                return None, False
            if not stream.recv(1, socket.MSG_PEEK):
                raise can.CanOperationError("the socketcand server closed the connection")
        message, filtered = super()._recv_internal(0.0)  # type: ignore[no-untyped-call]
        return message, filtered


class _Receiver(threading.Thread):
    """Feeds a network from its bus until told to stop or until the bus fails."""

    def __init__(self, bus: can.BusABC, network: _Network) -> None:
        super().__init__(name=f"CAN receiver {bus.channel_info}", daemon=True)
        self._bus = bus
        self._listener = network.listeners[0]
        self._stopping = threading.Event()
        self.failure: Exception | None = None

    def run(self) -> None:
        while not self._stopping.is_set():
            try:
                message = self._bus.recv(RECEIVE_CYCLE_S)
            except Exception as error:  # noqa: BLE001  whatever it is, it ends receiving and `check` reports it
                self.failure = error
                return
            if message is not None:
                self._listener.on_message_received(message)  # type: ignore[no-untyped-call]

    def stop(self) -> None:
        self._stopping.set()
        self.join(10.0 * RECEIVE_CYCLE_S)


@dataclass
class _SharedNetwork:
    bus: can.BusABC
    network: _Network
    receiver: _Receiver
    users: int = 0
    nodes: set[int] = field(default_factory=set)

    @classmethod
    def at(cls, address: CanAddress) -> _SharedNetwork:
        with _naming_the_link(address):
            bus = _open_bus(address)
        network = _Network(bus, drops_own_frames=address.interface in ECHOING_INTERFACES)
        receiver = _Receiver(bus, network)
        receiver.start()
        return cls(bus, network, receiver)

    def shut(self) -> None:
        self.receiver.stop()
        self.network.bus = None
        with contextlib.suppress(can.CanError, OSError):  # it may have died before
            self.bus.shutdown()


class CanNetworks:
    """The open networks of a process. Thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._open: dict[CanAddress, _SharedNetwork] = {}

    def acquire(self, address: CanAddress) -> CanLink:
        """A share in the network at `address`, which is opened if nobody has it.

        Raises LinkLost naming the link when it cannot be opened.
        """
        with self._lock:
            shared = self._open.get(address)
            if shared is None or shared.receiver.failure is not None:
                shared = _SharedNetwork.at(address)
                self._open[address] = shared
            shared.users += 1
        return CanLink(address, shared, self)

    def release(self, address: CanAddress, shared: _SharedNetwork) -> None:
        with self._lock:
            shared.users -= 1
            if shared.users > 0:
                return
            if self._open.get(address) is shared:
                del self._open[address]
        shared.shut()


class CanLink:
    """One device's share in a network. Close it; closing twice does nothing."""

    def __init__(self, address: CanAddress, shared: _SharedNetwork, networks: CanNetworks) -> None:
        self.address = address
        self._shared: _SharedNetwork | None = shared
        self._networks = networks
        self._own_nodes: set[int] = set()

    @property
    def name(self) -> str:
        return self.address.name

    def add_node(self, node_id: int, dictionary: ObjectDictionary) -> canopen.RemoteNode:
        """Raises ConfigurationError when another device of this process owns that node."""
        shared = self._require_open()
        if node_id in shared.nodes:
            raise ConfigurationError(
                f"two devices claim CANopen node {node_id}",
                link=self.name,
                hint="give each drive its own node id",
            )
        node = canopen.RemoteNode(node_id, dictionary)
        shared.network.add_node(node)
        shared.nodes.add(node_id)
        self._own_nodes.add(node_id)
        return node

    def check(self) -> None:
        """Raises LinkLost when the receiving thread has ended."""
        failure = self._require_open().receiver.failure
        if failure is not None:
            raise self.lost(f"receiving has stopped: {failure}")

    def lost(self, what: str) -> LinkLost:
        return LinkLost(
            f"CAN link lost, {what}",
            link=self.name,
            hint="check that the CAN adapter, interface or CAN server is up, then open the device again",
        )

    def close(self) -> None:
        shared, self._shared = self._shared, None
        if shared is None:
            return
        for node_id in self._own_nodes:
            del shared.network[node_id]
        shared.nodes -= self._own_nodes
        self._networks.release(self.address, shared)

    def _require_open(self) -> _SharedNetwork:
        if self._shared is None:
            raise LinkLost("CAN link is not open", link=self.name, hint="open the device first")
        return self._shared


PROCESS_NETWORKS = CanNetworks()
"""A CAN adapter can be opened once per process, so its owners share this one book."""


def _open_bus(address: CanAddress) -> can.BusABC:
    options = dict(address.options)
    if address.interface != "socketcand":
        return can.Bus(interface=address.interface, channel=address.channel, **cast(dict[str, Any], options))
    endpoint = (str(options["host"]), int(options["port"]))
    socket.create_connection(endpoint, timeout=CONNECT_WITHIN_S).close()
    return _SocketcandBus(channel=address.channel, **options)  # type: ignore[no-untyped-call]


@contextlib.contextmanager
def _naming_the_link(address: CanAddress) -> Iterator[None]:
    try:
        yield
    except (can.CanInterfaceNotImplementedError, TypeError, ValueError, KeyError, ImportError) as error:
        raise ConfigurationError(
            f"the CAN bus cannot be opened with these settings: {error!r}",
            link=address.name,
            hint="check interface, channel and options against python-can's list of interfaces",
        ) from error
    except (can.CanError, OSError) as error:
        raise LinkLost(
            f"cannot open the CAN bus: {error}",
            link=address.name,
            hint="check that the interface exists and is up (ip link), or that the CAN server is running",
        ) from error
