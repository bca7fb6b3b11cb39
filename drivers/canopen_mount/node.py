"""CANopen node of a drive: its objects (read and written by SDO, service data objects), its emergency messages and its
heartbeat. A monitor of the node detects restarts, silence, emergency messages and changes of the network state.

The messages of a node arrive in order. When the answer to an SDO request arrives, every earlier message of the node has
therefore been received. After a read of the statusword, all earlier emergency and boot-up messages are known.
"""

from __future__ import annotations

import struct
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
from drivers.foreign_errors import cause_of
from drivers.links.can_bus import CanLink

T = TypeVar("T")

NO_SUCH_OBJECT = (0x0602_0000, 0x0609_0011)
"""SDO abort codes of CiA 301 for an object or a sub-index that does not exist."""
OUT_OF_MEMORY = 0x0504_0005
"""SDO abort code of CiA 301 with which a transfer is ended that becomes too long."""
MAX_UPLOAD_BYTES = 512
"""Longest content of an object that is read. It is segmented in parts of 7 bytes, of which a node can send any number.
The names and versions of drives are shorter than 64 bytes."""
NMT_OPERATIONAL = 0x05

_log = structlog.get_logger("canopen_mount")


class DriveNode:
    """CANopen node of a drive; `axis` is its name in error messages. If `look_only` is True, all writes and commands
    are refused, and no request is repeated.

    An SDO request that is not answered is repeated once, so it takes up to twice `sdo_timeout_s` of wall time. Requests
    that write are repeated, too, because writing a value twice has no further effect: target positions are absolute,
    and commands in the controlword take effect on the rising edge of a bit.
    """

    def __init__(
        self,
        link: CanLink,
        node_id: int,
        axis: str,
        dictionary: ObjectDictionary,
        *,
        sdo_timeout_s: float,
        look_only: bool = False,
    ) -> None:
        self.axis = axis
        self.node_id = node_id
        self._link = link
        self._look_only = look_only
        self._node: canopen.RemoteNode = link.add_node(node_id, dictionary)
        self._node.sdo.RESPONSE_TIMEOUT = sdo_timeout_s
        self._exchange = threading.Lock()
        self._seen = threading.Lock()
        self._heartbeats = 0
        self._booted = False
        self._nmt_state: int | None = None
        self._emergencies: list[int] = []
        self._sent: set[DriveObject] = set()
        self._node.nmt.add_heartbeat_callback(self._on_heartbeat)
        self._node.emcy.add_callback(self._on_emergency)

    @property
    def where(self) -> dict[str, str]:
        return {"axis": self.axis, "node": str(self.node_id), "link": self._link.name}

    def read(self, entry: DriveObject) -> int:
        """Read an object of the node from its object dictionary.

        Raises CommandRejected if the node refuses the request, for example because it has no such object. Raises
        LinkLost, LinkTimeout or ProtocolError if there is no valid answer.
        """
        data = self.read_bytes(entry)
        if len(data) != entry.size:
            raise ProtocolError(
                f"the drive answered {len(data)} bytes for {entry}, but its data type has {entry.size} bytes",
                hint="check that the node id belongs to the drive that is configured",
                **self.where,
            )
        return entry.unpack(data)

    def read_optional(self, entry: DriveObject) -> int | None:
        """Read an object of the node; return None if the node reports that it has no such object.

        Raises the same errors as `read` in all other cases.
        """
        try:
            return self.read(entry)
        except CommandRejected as refused:
            if _has_no_such_object(refused):
                return None
            raise

    def read_text(self, index: int) -> str:
        """Return the text stored in the object at `index`; an empty string if the node refuses to read it."""
        try:
            data = self._transfer(f"0x{index:04X}", lambda: self._upload(index, 0))
        except CommandRejected:
            return ""
        return data.split(b"\0")[0].decode("ascii", errors="replace").strip()

    def read_bytes(self, entry: DriveObject) -> bytes:
        """Return the content of an object of the node. Raises the same errors as `read`.

        A drive does not lose an object that it has sent before: such an answer is one to a request that was altered on
        the way, for example between an adapter on a serial line or a network and this computer.
        """
        try:
            content = self._transfer(str(entry), lambda: self._upload(entry.index, entry.subindex))
        except CommandRejected as refused:
            if entry in self._sent and _has_no_such_object(refused):
                raise ProtocolError(
                    f"the drive has sent {entry} before, and now answers that it has no such object",
                    hint="a byte was altered on the way; check the cable, the connectors and the CAN adapter",
                    **self.where,
                ) from refused
            raise
        self._sent.add(entry)
        return content

    def write(self, entry: DriveObject, value: int) -> None:
        """Write a value to an object of the node.

        Raises the same errors as `read`. The text of the error CommandRejected contains the reason that the drive
        gives.
        """
        self._require_open_for_a_run()
        data = entry.pack(value)
        self._transfer(str(entry), lambda: self._node.sdo.download(entry.index, entry.subindex, data))

    def start(self) -> None:
        """Switch the node to the state *operational* by a command of the network management (NMT).

        The NMT command has no answer of its own. Therefore an object is read afterwards, whose answer shows that the
        node has processed the command.
        """
        self._require_open_for_a_run()
        try:
            self._link.check()
            self._node.nmt.state = "OPERATIONAL"
        except (can.CanError, OSError) as error:
            raise self._link.lost_error(cause_of(error)).at(**self.where) from error
        self.read(STATUSWORD)

    def _require_open_for_a_run(self) -> None:
        if self._look_only:
            raise CommandRejected(
                "refused by a mount that was opened only to read",
                hint="close it and open it for a run",
                **self.where,
            )

    def take_boot_up(self) -> bool:
        """Return True if the node has sent a boot-up message since the last call of this method."""
        with self._seen:
            booted, self._booted = self._booted, False
        return booted

    def take_heartbeat(self) -> bool:
        with self._seen:
            seen, self._heartbeats = self._heartbeats > 0, 0
        return seen

    def take_nmt_state(self) -> int | None:
        """Return the network state (NMT state) that the node reported in its latest heartbeat.

        Return None if no heartbeat has arrived since the last call of this method.
        """
        with self._seen:
            state, self._nmt_state = self._nmt_state, None
        return state

    def take_emergencies(self) -> list[int]:
        """Return the error codes of the emergency messages that the node has sent since the last call of this method,
        oldest first.
        """
        with self._seen:
            codes, self._emergencies = self._emergencies, []
        return codes

    def _on_heartbeat(self, state: int) -> None:
        with self._seen:
            self._heartbeats += 1
            self._booted = self._booted or state == 0
            self._nmt_state = state

    def _on_emergency(self, emergency: canopen.emcy.EmcyError) -> None:
        with self._seen:
            self._emergencies.append(int(emergency.code))

    def _upload(self, index: int, subindex: int) -> bytes:
        """Read an object, which may come in segments. Raises ProtocolError if it has more than MAX_UPLOAD_BYTES bytes,
        where an empty segment counts as one.

        A drive may send four bytes for an object that is shorter by its description; the further ones are cut off.
        """
        content, received = b"", 0
        with self._node.sdo.open(index, subindex, buffering=0) as segments:
            # An empty segment need not be the last one (CiA 301 allows n = 7), which only the stream itself knows.
            while not segments._done:
                segment = bytes(segments.read(1))
                content += segment
                received += max(len(segment), 1)  # empty segments without an end are endless, too
                if received > MAX_UPLOAD_BYTES:
                    self._node.sdo.abort(OUT_OF_MEMORY)
                    raise ProtocolError(
                        f"the drive sends more than {MAX_UPLOAD_BYTES} bytes for 0x{index:04X}",
                        hint="check that the node id belongs to the drive that is configured",
                        **self.where,
                    )
        described = self._node.object_dictionary.get_variable(index, subindex)
        return content[: len(described) // 8] if described is not None and described.fixed_size else content

    def _transfer(self, entry: str, exchange: Callable[[], T]) -> T:
        try:
            return self._exchange_once(entry, exchange)
        except LinkTimeout:
            if self._look_only:
                raise  # the next look repeats it; a drive that is off would fill the log
            _log.warning("SDO answer missing, request repeated", object=entry, **self.where)
            return self._exchange_once(entry, exchange)

    def _exchange_once(self, entry: str, exchange: Callable[[], T]) -> T:
        with self._exchange:
            try:
                self._link.check()
                return exchange()
            except canopen.SdoAbortedError as error:
                raise CommandRejected(
                    f"the drive refused {entry}: abort code 0x{error.code:08X}",
                    hint="compare with the drive's manual",
                    **self.where,
                ) from error
            except canopen.SdoCommunicationError as error:
                raise self._unanswered(entry, error) from error
            except struct.error as error:
                raise ProtocolError(
                    f"the SDO answer for {entry} is too short",
                    hint="every SDO frame has 8 bytes: check that no other device uses the identifiers of this node",
                    **self.where,
                ) from error
            except (can.CanError, OSError) as error:
                raise self._link.lost_error(cause_of(error)).at(**self.where) from error

    def _unanswered(self, entry: str, error: Exception) -> DeviceError:
        if "No SDO response" not in str(error):
            return ProtocolError(
                f"unexpected SDO answer for {entry}: {cause_of(error)}",
                hint="check that no other CANopen master talks to this node",
                **self.where,
            )
        text = self._link.adapter_status_text()
        return LinkTimeout(
            f"no SDO response from node {self.node_id} to {entry}" + (f"; {text}" if text else ""),
            hint="check that the drive is powered, its node id, the bit rate, the cable and both terminators",
            **self.where,
        )


class NodeMonitor:
    """Monitor of one CANopen node; the driver calls `check` repeatedly during every wait for the drive.

    The age of the latest heartbeat is measured on the given clock. A heartbeat may seem late only because this process
    was busy. Therefore the node is queried by an SDO request before it is declared lost.
    """

    def __init__(self, node: DriveNode, clock: Clock, *, timeout_s: float | None) -> None:
        self._node = node
        self._clock = clock
        self._timeout_s = timeout_s
        self._last_s = clock.now()
        self._silent = False

    @property
    def silent(self) -> bool:
        """True if the node sends no heartbeat, but answered when it was last queried for this reason."""
        return self._silent

    def arm(self) -> None:
        self._silent = False
        self._node.take_boot_up()
        self._node.take_nmt_state()
        self._node.take_emergencies()
        self._last_s = self._clock.now()

    def check(self) -> list[int]:
        """Log and return the error codes of the emergency messages that the node has sent since the last call.

        Raises MotionFault if the node has restarted or left the network state (NMT state) *operational*. Raises
        LinkTimeout or LinkLost if the node no longer answers.
        """
        codes = [code for code in self._node.take_emergencies() if code]
        for code in codes:
            _log.warning("emergency", text=emergency_text(code), **self._node.where)
        if self._node.take_boot_up():
            raise MotionFault(
                "the drive has restarted",
                hint="check its supply; home the mount again before turning it",
                **self._node.where,
            )
        if (state := self._node.take_nmt_state()) not in (None, NMT_OPERATIONAL):
            raise MotionFault(
                f"the node has left the NMT state operational, its heartbeat reports 0x{state:02X}",
                hint="another CANopen master or the drive's own monitoring (0x1029, 0x1016) has stopped it",
                **self._node.where,
            )
        if self._node.take_heartbeat():
            self._note_heartbeat()
        elif self._timeout_s is not None and self._clock.now() - self._last_s > self._timeout_s:
            self._probe_by_sdo()
        return codes

    def _note_heartbeat(self) -> None:
        self._last_s = self._clock.now()
        if self._silent:
            self._silent = False
            _log.info("heartbeat available again", **self._node.where)

    def _probe_by_sdo(self) -> None:
        self._node.read(STATUSWORD)
        self._last_s = self._clock.now()
        if not self._silent:
            self._silent = True
            _log.warning("heartbeat missing, the drive still answers", **self._node.where)


def _has_no_such_object(refused: CommandRejected) -> bool:
    """Return True if the drive refused because it has no such object or sub-index."""
    return isinstance(refused.__cause__, canopen.SdoAbortedError) and refused.__cause__.code in NO_SUCH_OBJECT
