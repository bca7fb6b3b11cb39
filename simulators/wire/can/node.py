"""CANopen node according to CiA 301.

The node is a slave in network management (NMT), a producer of heartbeats and emergency messages (EMCY), and a server
for service data objects (SDO). Frames are (identifier, data) pairs. The node has no bus and no thread; `advance` sets
its time.
"""

from __future__ import annotations

import struct
from enum import IntEnum
from functools import partial
from typing import Protocol

from simulators.wire.can.sdo import ObjectDictionary, ObjectEntry, SdoServer

Frame = tuple[int, bytes]

HARDWARE_VERSION, SOFTWARE_VERSION = "simulated", "volcal"
"""Contents of objects 0x1009 and 0x100A."""


class NmtState(IntEnum):
    BOOT_UP = 0x00
    STOPPED = 0x04
    OPERATIONAL = 0x05
    PRE_OPERATIONAL = 0x7F


class Application(Protocol):
    """Device application of a node: the part that implements the device and not the communication (CiA 301)."""

    @property
    def error_register(self) -> int: ...

    def dictionary(self) -> ObjectDictionary: ...

    def reset(self) -> None:
        """Restore the power-on state."""

    def advance(self, now_s: float) -> None: ...

    def take_emergencies(self) -> list[int]:
        """Return the error codes of the emergency messages to be sent, oldest first. Code 0 means that an error was
        reset.
        """


class CanopenNode:
    """Simulated CANopen node with one device application.

    `device_type` is the value of object 0x1000. `identity` is the value of object 0x1018: vendor, product, revision and
    serial number.
    """

    def __init__(
        self,
        node_id: int,
        application: Application,
        *,
        device_type: int,
        device_name: str,
        identity: tuple[int, int, int, int],
    ) -> None:
        self.node_id = node_id
        self.state = NmtState.PRE_OPERATIONAL
        self.silent = False
        self._answers_to_lose = 0
        self._application = application
        self._heartbeat_ms = 0
        self._next_heartbeat_s = 0.0
        self._watched = 0
        self._now_s = 0.0
        self._errors: list[int] = []
        own: dict[tuple[int, int], ObjectEntry] = {
            (0x1000, 0): ObjectEntry("I", lambda: device_type),
            (0x1001, 0): ObjectEntry("B", lambda: application.error_register),
            (0x1003, 0): ObjectEntry("B", lambda: len(self._errors)),
            (0x1003, 1): ObjectEntry("I", lambda: self._errors[0] if self._errors else 0),
            (0x1008, 0): ObjectEntry("", lambda: device_name),
            (0x1009, 0): ObjectEntry("", lambda: HARDWARE_VERSION),
            (0x100A, 0): ObjectEntry("", lambda: SOFTWARE_VERSION),
            (0x1016, 0): ObjectEntry("B", lambda: 1),
            (0x1016, 1): ObjectEntry("I", lambda: self._watched, self._set_watched),
            (0x1017, 0): ObjectEntry("H", lambda: self._heartbeat_ms, self._set_heartbeat),
            (0x1018, 0): ObjectEntry("B", lambda: 4),
        }
        for subindex, number in enumerate(identity, start=1):
            own[0x1018, subindex] = ObjectEntry("I", partial(int, number))
        self._sdo = SdoServer({**own, **application.dictionary()})

    def boot(self) -> list[Frame]:
        """Boot, as after power-on or reset: enter the pre-operational state and return the boot-up message."""
        self._application.reset()
        self.state = NmtState.PRE_OPERATIONAL
        self._heartbeat_ms = 0
        return self._out([(0x700 + self.node_id, bytes([NmtState.BOOT_UP]))])

    def receive(self, identifier: int, data: bytes) -> list[Frame]:
        """Return the frames with which the node answers one frame on the bus."""
        if self.silent:
            return []
        if identifier == 0x000 and len(data) == 2 and data[1] in (0, self.node_id):
            return self._command(data[0])
        if identifier == 0x600 + self.node_id and self.state is not NmtState.STOPPED:
            answer = self._sdo.answer(data)
            if answer is not None and self._answers_to_lose:
                self._answers_to_lose -= 1
                answer = None
            emergencies = self._emergency_frames()
            return emergencies + ([(0x580 + self.node_id, answer)] if answer is not None else [])
        return []

    def advance(self, now_s: float) -> list[Frame]:
        """Advance the node to the time `now_s`, and return the frames that the node must send until then.

        The frames contain only one heartbeat even if several heartbeats were due.
        """
        self._now_s = now_s
        self._application.advance(now_s)
        frames = self._emergency_frames()
        if self._heartbeat_ms and now_s >= self._next_heartbeat_s:
            self._next_heartbeat_s = now_s + 1e-3 * self._heartbeat_ms
            frames.append((0x700 + self.node_id, bytes([self.state])))
        return self._out(frames)

    def stop_heartbeat(self) -> None:
        """Stop the heartbeat. The node still answers requests."""
        self._heartbeat_ms = 0

    def lose_answers(self, count: int) -> None:
        """Drop the next `count` answers of the service data object (SDO) server. The requests are nevertheless
        executed.
        """
        self._answers_to_lose = count

    def _command(self, command: int) -> list[Frame]:
        targets = {0x01: NmtState.OPERATIONAL, 0x02: NmtState.STOPPED, 0x80: NmtState.PRE_OPERATIONAL}
        if command in targets:
            self.state = targets[command]
            return []
        return self.boot() if command in (0x81, 0x82) else []

    def _set_heartbeat(self, period_ms: int) -> None:
        self._heartbeat_ms = period_ms
        self._next_heartbeat_s = self._now_s + 1e-3 * period_ms

    def _set_watched(self, value: int) -> None:
        self._watched = value

    def _emergency_frames(self) -> list[Frame]:
        """Return the pending EMCY frames.

        COB-ID 0x80 + node: error code, error register, five manufacturer-specific bytes (CiA 301, 7.2.7).
        """
        frames: list[Frame] = []
        for code in self._application.take_emergencies():
            if code:
                self._errors.insert(0, code)
            data = struct.pack("<HB5x", code, self._application.error_register)
            frames.append((0x80 + self.node_id, data))
        return frames

    def _out(self, frames: list[Frame]) -> list[Frame]:
        return [] if self.silent else frames
