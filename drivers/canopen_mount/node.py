"""One CANopen node: its objects by SDO, its emergencies, its heartbeat. Every failure is a typed error.

Everything a node sends arrives in order, so whatever it sent before an SDO answer has been seen when that
answer is here. A read of the statusword therefore also brings the emergencies and boot-ups before it.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TypeVar

import can
import canopen
import structlog
from canopen.objectdictionary import ObjectDictionary

from drivers.canopen_mount.emergency import emergency_text
from drivers.canopen_mount.objects import STATUSWORD, DriveObject
from drivers.clock import Clock
from drivers.errors import CommandRejected, DeviceError, LinkTimeout, MotionFault, ProtocolError
from drivers.links.can_bus import CanLink

T = TypeVar("T")

_log = structlog.get_logger("canopen_mount")


class DriveNode:
    """`axis` is how messages call it. SDO exchanges take wall time, bounded by twice `sdo_timeout_s`.

    An exchange without an answer is repeated once, reads and writes alike: the same value written twice changes
    nothing, because targets are absolute and the commands in the controlword act on the rising edge of a bit.
    """

    def __init__(
        self,
        link: CanLink,
        node_id: int,
        axis: str,
        dictionary: ObjectDictionary,
        *,
        sdo_timeout_s: float,
    ) -> None:
        self.axis = axis
        self.node_id = node_id
        self._link = link
        self._node: canopen.RemoteNode = link.add_node(node_id, dictionary)
        self._node.sdo.RESPONSE_TIMEOUT = sdo_timeout_s
        self._exchange = threading.Lock()
        self._seen = threading.Lock()
        self._heartbeats = 0
        self._booted = False
        self._emergencies: list[int] = []
        self._node.nmt.add_heartbeat_callback(self._on_heartbeat)
        self._node.emcy.add_callback(self._on_emergency)

    @property
    def where(self) -> dict[str, str]:
        return {"axis": self.axis, "node": str(self.node_id), "link": self._link.name}

    def read(self, entry: DriveObject) -> int:
        """Raises LinkLost, LinkTimeout, ProtocolError, CommandRejected (the node has no such object)."""
        data = self.read_bytes(entry)
        if len(data) != entry.size:
            raise ProtocolError(
                f"the drive answered {len(data)} bytes for {entry}, its data type has {entry.size}",
                hint="check that the node id belongs to the drive that is configured",
                **self.where,
            )
        return entry.unpack(data)

    def read_bytes(self, entry: DriveObject) -> bytes:
        return bytes(self._transfer(entry, lambda: self._node.sdo.upload(entry.index, entry.subindex)))

    def write(self, entry: DriveObject, value: int) -> None:
        """Raises as `read`; CommandRejected carries the drive's reason."""
        data = entry.pack(value)
        self._transfer(entry, lambda: self._node.sdo.download(entry.index, entry.subindex, data))

    def start(self) -> None:
        """NMT: go to *operational*."""
        try:
            self._link.check()
            self._node.nmt.state = "OPERATIONAL"
        except (can.CanError, OSError) as error:
            raise self._link.lost(str(error)).at(**self.where) from error

    def take_boot_up(self) -> bool:
        """Whether the node announced a boot-up since the last call."""
        with self._seen:
            booted, self._booted = self._booted, False
        return booted

    def take_heartbeat(self) -> bool:
        with self._seen:
            seen, self._heartbeats = self._heartbeats > 0, 0
        return seen

    def take_emergencies(self) -> list[int]:
        """Error codes received since the last call, oldest first."""
        with self._seen:
            codes, self._emergencies = self._emergencies, []
        return codes

    def _on_heartbeat(self, state: int) -> None:
        with self._seen:
            self._heartbeats += 1
            self._booted = self._booted or state == 0

    def _on_emergency(self, emergency: canopen.emcy.EmcyError) -> None:
        with self._seen:
            self._emergencies.append(int(emergency.code))

    def _transfer(self, entry: DriveObject, exchange: Callable[[], T]) -> T:
        try:
            return self._exchange_once(entry, exchange)
        except LinkTimeout:
            _log.warning("SDO answer missing, asked again", object=str(entry), **self.where)
            return self._exchange_once(entry, exchange)

    def _exchange_once(self, entry: DriveObject, exchange: Callable[[], T]) -> T:
        with self._exchange:
            try:
                self._link.check()
                return exchange()
            except canopen.SdoAbortedError as error:
                raise CommandRejected(
                    f"the drive refused {entry}: {error}", hint="compare with the drive's manual", **self.where
                ) from error
            except canopen.SdoCommunicationError as error:
                raise self._unanswered(entry, error) from error
            except (can.CanError, OSError) as error:
                raise self._link.lost(str(error)).at(**self.where) from error

    def _unanswered(self, entry: DriveObject, error: Exception) -> DeviceError:
        if "No SDO response" not in str(error):
            return ProtocolError(
                f"unexpected SDO answer for {entry}: {error}",
                hint="check that no other CANopen master talks to this node",
                **self.where,
            )
        return LinkTimeout(
            f"no SDO response from node {self.node_id} to {entry}",
            hint="check that the drive is powered, its node id, the bit rate, the cable and both terminators",
            **self.where,
        )


class NodeWatch:
    """Notices restarts and silence of a node; called wherever the driver waits.

    The age of the heartbeat is taken on the clock handed in, in the thread that waits. A heartbeat may be
    late because this process was busy, so the node is asked by SDO before it is declared lost.
    """

    def __init__(self, node: DriveNode, clock: Clock, *, timeout_s: float | None) -> None:
        self._node = node
        self._clock = clock
        self._timeout_s = timeout_s
        self._last_s = clock.now()
        self._silent = False

    def arm(self) -> None:
        self._node.take_boot_up()
        self._node.take_emergencies()
        self._last_s = self._clock.now()

    def check(self) -> None:
        """Raises MotionFault after a restart, LinkTimeout or LinkLost when the node is gone."""
        for code in self._node.take_emergencies():
            _log.warning("emergency", text=emergency_text(code), **self._node.where)
        if self._node.take_boot_up():
            raise MotionFault(
                "the drive has restarted",
                hint="check its supply; home the mount again before it is turned",
                **self._node.where,
            )
        if self._node.take_heartbeat():
            self._heard()
        elif self._timeout_s is not None and self._clock.now() - self._last_s > self._timeout_s:
            self._ask()

    def _heard(self) -> None:
        self._last_s = self._clock.now()
        if self._silent:
            self._silent = False
            _log.info("heartbeat available again", **self._node.where)

    def _ask(self) -> None:
        self._node.read(STATUSWORD)
        self._last_s = self._clock.now()
        if not self._silent:
            self._silent = True
            _log.warning("heartbeat missing, the drive still answers", **self._node.where)
