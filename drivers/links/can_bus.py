"""CANopen networks of this process, one for each CAN channel, shared by all devices on the channel.

A CAN channel can be opened only once per process, and it carries every node of every mount on the channel. Devices with
the same interface, channel and options therefore share one `canopen.Network`. The bus is shut down when the last of
these devices closes its link.

Frames are received by a thread of this module instead of the notifier of python-can. The notifier ends at the first
exception; a notifier with an exception handler repeats the exception in a busy loop instead. The thread of this module
ends at the first failure or if the controller goes bus-off; `CanLink.check` then raises LinkLost.

Some interfaces echo the frames that this process has sent. These frames are dropped. They are recognised by their
identifier, since only one node uses an identifier for sending in CANopen.
"""

from __future__ import annotations

import contextlib
import logging
import threading
from collections.abc import Sequence
from dataclasses import dataclass, field
from queue import Empty, Queue

import can
import canopen
import structlog
from canopen.objectdictionary import ObjectDictionary

from drivers.errors import ConfigurationError, LinkLost
from drivers.foreign_errors import cause_of
from drivers.links.can_adapters import ECHOING_INTERFACES, BusFailure, CanAddress, SlcanBus, open_bus

for _library in ("can", "canopen"):  # errors that they log are raised as typed errors here
    logging.getLogger(_library).addHandler(logging.NullHandler())
# A drive that is off would otherwise leave a line of this library in the log with each look.
logging.getLogger("canopen.sdo.client").addFilter(lambda record: record.levelno < logging.ERROR)

RECEIVE_CYCLE_S = 0.1
"""Longest wait of the receiving thread for one frame in s; closing the bus takes up to this long."""
SDO_CHANNEL = (0x600, 0x580)
"""Identifiers of requests and answers of service data, each plus the node id (predefined connections of CiA 301)."""
BUS_OFF = 0x40
CONTROLLER_PROBLEM = 0x04
"""`BUS_OFF` and `CONTROLLER_PROBLEM` are error-class bits of error frames (linux/can/error.h).

Some interfaces send no error frames.
"""

_log = structlog.get_logger("can_bus")


class _Network(canopen.Network):
    """CANopen network that ignores its own frames if the interface echoes them."""

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


class _Receiver(threading.Thread):
    """Thread that passes frames from the bus to a network until it is stopped or the bus fails."""

    def __init__(self, bus: can.BusABC, network: _Network) -> None:
        super().__init__(name=f"CAN receiver {bus.channel_info}", daemon=True)
        self._bus = bus
        self._listener = network.listeners[0]
        self._stopping = threading.Event()
        self._warned = False
        self.failure: Exception | None = None

    def run(self) -> None:
        while not self._stopping.is_set():
            try:
                message = self._bus.recv(RECEIVE_CYCLE_S)
            except Exception as error:  # noqa: BLE001  any error ends receiving; `check` reports it
                self.failure = error
                return
            if message is None:
                continue
            if message.is_error_frame:
                self._handle_error_frame(message.arbitration_id)
            else:
                self._listener.on_message_received(message)  # type: ignore[no-untyped-call]

    def _handle_error_frame(self, classes: int) -> None:
        if classes & BUS_OFF:
            self.failure = BusFailure("the CAN controller has gone off the bus (bus-off)")
            self._stopping.set()
        elif classes & CONTROLLER_PROBLEM and not self._warned:
            self._warned = True
            _log.warning("CAN controller reports errors: check bit rate, cable and terminators", bus=self.name)

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
        bus = open_bus(address)
        network = _Network(bus, drops_own_frames=address.interface in ECHOING_INTERFACES)
        receiver = _Receiver(bus, network)
        receiver.start()
        return cls(bus, network, receiver)

    def close_bus(self) -> None:
        self.receiver.stop()
        self.network.bus = None
        with contextlib.suppress(can.CanError, OSError):  # the bus may have failed before
            self.bus.shutdown()


class CanNetworks:
    """Open CAN networks of a process; the methods are thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._open: dict[CanAddress, _SharedNetwork] = {}

    def acquire(self, address: CanAddress) -> CanLink:
        """Return a link to the network at `address`; open the network first if it is not open.

        Raises LinkLost if the network cannot be opened, and ConfigurationError if the settings are impossible or the
        bus is already open with other options. The error names the link.
        """
        with self._lock:
            self._refuse_second_opening(address)
            shared = self._open.get(address)
            if shared is None or shared.receiver.failure is not None:
                shared = _SharedNetwork.at(address)
                self._open[address] = shared
            shared.users += 1
        return CanLink(address, shared, self)

    def _refuse_second_opening(self, address: CanAddress) -> None:
        for other in self._open:
            if other.name == address.name and other != address:
                raise ConfigurationError(
                    "two devices have different options for one CAN bus",
                    link=address.name,
                    hint="set the same interface, channel and options for both; they then share the bus",
                )

    def release(self, address: CanAddress, shared: _SharedNetwork) -> None:
        with self._lock:
            shared.users -= 1
            if shared.users > 0:
                return
            if self._open.get(address) is shared:
                del self._open[address]
        shared.close_bus()


class CanLink:
    """Access of one device to a shared CAN network.

    The device must close the link. Closing the link twice has no effect.
    """

    def __init__(self, address: CanAddress, shared: _SharedNetwork, networks: CanNetworks) -> None:
        self.address = address
        self._shared: _SharedNetwork | None = shared
        self._networks = networks
        self._own_nodes: set[int] = set()

    @property
    def name(self) -> str:
        return self.address.name

    def add_node(self, node_id: int, dictionary: ObjectDictionary) -> canopen.RemoteNode:
        """Add a node to the network.

        Raises ConfigurationError if a device of this process already uses the node id.
        """
        shared = self._require_open()
        if node_id in shared.nodes:
            raise ConfigurationError(
                f"two devices claim CANopen node {node_id}",
                link=self.name,
                hint="set a different node id for each drive",
            )
        node = canopen.RemoteNode(node_id, dictionary)
        shared.network.add_node(node)
        shared.nodes.add(node_id)
        self._own_nodes.add(node_id)
        return node

    def await_exchange(self, node_ids: Sequence[int], within_s: float) -> int | None:
        """Return the id of the first of these nodes that exchanges service data with another client of the bus within
        `within_s` of wall time; None if none does.

        Nothing is sent. The answer means something only before this device has sent to the nodes itself.
        """
        network, seen = self._require_open().network, Queue[int]()
        identifiers = {base + node_id: node_id for node_id in node_ids for base in SDO_CHANNEL}

        def note(can_id: int, _data: bytearray, _timestamp: float) -> None:
            seen.put(identifiers[can_id])

        for identifier in identifiers:
            network.subscribe(identifier, note)
        try:
            return seen.get(timeout=within_s)
        except Empty:
            self.check()
            return None
        finally:
            for identifier in identifiers:
                network.unsubscribe(identifier, note)

    def check(self) -> None:
        """Raise LinkLost if the thread that receives the frames has ended."""
        failure = self._require_open().receiver.failure
        if failure is not None:
            raise self.lost_error(f"receiving has stopped: {cause_of(failure)}")

    def adapter_status_text(self) -> str:
        """Query the status of the CAN adapter and return it as text.

        Return an empty string if the status of this kind of adapter cannot be queried.
        """
        bus = self._require_open().bus
        if not isinstance(bus, SlcanBus):
            return ""
        try:
            reported = bus.status_text()
        except (can.CanError, OSError) as error:
            raise self.lost_error(cause_of(error)) from error
        return f"{reported}; it has refused {bus.refusals} commands" if bus.refusals else reported

    def lost_error(self, what: str) -> LinkLost:
        return LinkLost(
            f"CAN link lost: {what}",
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
            raise LinkLost("the CAN link is not open", link=self.name, hint="open the device first")
        return self._shared


PROCESS_NETWORKS = CanNetworks()
"""Networks of this process. A CAN adapter can be opened once per process, so all devices share this object."""
