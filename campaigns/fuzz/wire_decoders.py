"""Decoders of frames and lines: what devices, panels and clients of the simulator send."""

from __future__ import annotations

import json
from collections.abc import Awaitable, Callable, Iterator, Sequence
from http import HTTPStatus
from typing import Any

import can
import canopen
from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.types import Message, Receive, Scope, Send

from agent.service.gateway.frames import HEADER, FramingError, body_length
from agent.service.gateway.frames import answer_request as answer_panel
from agent.service.http.events import EVENT_NUMBER
from agent.service.http.guard import Guard
from campaigns.fuzz.trial import Decoder
from drivers.canopen_mount.emergency import emergency_text
from drivers.canopen_mount.node import DriveNode
from drivers.canopen_mount.objects import STATUSWORD
from drivers.errors import LinkTimeout, ProtocolError
from drivers.links.modbus import ModbusLink
from drivers.linuxcnc.bridge_link import BridgeLink
from drivers.linuxcnc.snapshot import parse_snapshot
from drivers.serial_cnc.controller_settings import ControllerSettings
from drivers.serial_cnc.lines import GarbledLineError, MessageLine, SettingLine, parse_line
from simulators.wire.can.sdo import ObjectEntry, SdoServer
from simulators.wire.can.slcan_peer import parse_frame
from simulators.wire.can.socketcand_server import parse_send
from simulators.wire.modbus.frames import ModbusFramingError, answer_request, split_frames

NODE = 5
WHERE = {"device": "cnc", "link": "fuzz"}
GRBL_LINES = (
    b"ok", b"error:20", b"ALARM:5", b"$110=8000.000", b"$N0=G54", b"Grbl 1.1h ['$' for help]",
    b"<Idle|MPos:0.000,0.000,0.000|FS:0,0|WCO:0.000,0.000,0.000>", b"<Hold:0|WPos:1.0,2.0,3.0|Ov:100,100,100|Pn:P>",
    b"[PRB:1.000,2.000,3.000:1]", b"[VER:1.1h.20190825:]", b"[OPT:V,15,128]", b"[GC:G0 G54 G17 G21 G90]",
)  # fmt: skip
HEADERS = (
    b"host: 127.0.0.1:8080\norigin: http://127.0.0.1:8080\ncontent-length: 12\nlast-event-id: 17",
    b"host: [::1]:8080\nauthorization: Bearer 0123456789abcdef",
)
SNAPSHOT: dict[str, Any] = {
    "position": [0.0, 0.0, 0.0], "probed": [0.0, 0.0, 0.0], "eoffset": [0.0, 0.0, 0.0], "probe": False, "state": "done",
    "joint_faults": [], "on_limit": [], "program_offset": [0.0, 0.0, 0.0], "modal": [54.0], "errors": [], "pins": [],
    "tripped": False, "task_state": "on", "mode": "mdi", "idle": True, "paused": False, "in_position": True,
    "homed": True, "homing": False, "spindle": False, "tool": 1, "rotation_deg": 0.0, "feed_override": 1.0,
    "rapid_override": 1.0, "abandoned": False, "held_by_volcal": False, "monotonic_s": 12.5,
}  # fmt: skip


def wire_decoders() -> Iterator[Decoder]:
    panel = [_framed("03 0002 0010"), _framed("05 0003 FF00"), _framed("10 00C8 0002 04 0001 0002"), _framed("01 0 4")]
    yield Decoder("Modbus request of a panel", panel[:3], _panel_request, (FramingError,))
    yield Decoder("Modbus request to the simulator", panel[:1], _simulator_request, (ModbusFramingError,))
    answers = [bytes.fromhex("03 04 0001 0002"), bytes.fromhex("10 03E8 0002"), bytes.fromhex("83 02")]
    yield Decoder("Modbus answer of a controller", answers[:1], _controller_answer)
    upload = [bytes.fromhex("4b 41 60 00 37 06 00 00")]
    yield Decoder("SDO answer of a drive", upload, _drive_answer)
    segments = [bytes.fromhex("41 08 10 00 0d 00 00 00 00 61 20 6c 6f 6e 67 20 15 6e 61 6d 65 00 00 00")]
    yield Decoder("SDO answers in segments", segments, _drive_text)
    requests = [bytes.fromhex("40 41 60 00 00 00 00 00"), bytes.fromhex("2b 41 60 00 37 06 00 00")]
    yield Decoder("SDO request to the simulator", requests, _drive_request)
    yield Decoder(
        "frame of a serial CAN adapter", [b"t60584041600000000000", b"T000006050"], _text(parse_frame), _VALUE
    )
    yield Decoder("command to socketcand", [b"605 8 40 41 60 00 00 00 00 00"], _text(_socketcand), _VALUE)
    yield Decoder("line of a GRBL controller", GRBL_LINES, _grbl_line, (GarbledLineError,))
    yield Decoder("emergency message of a drive", [bytes.fromhex("10 82 11 00 00 00 00 00")], _emergency)
    yield Decoder("headers of an HTTP request", HEADERS, _headers, (HTTPException,))
    bridge = json.dumps({"id": 1, "ok": SNAPSHOT}).encode()
    yield Decoder("line of the LinuxCNC bridge", [bridge], _bridge_line)


_VALUE = (ValueError,)


def _framed(text: str) -> bytes:
    body = bytes.fromhex(text.replace(" 0 4", " 0000 0004"))
    return HEADER.pack(1, 0, len(body) + 1, 1) + body


def _text(parse: Callable[[str], object]) -> Callable[[bytes], object]:
    """Return a decoder of ASCII text; other bytes are refused before, as by the callers of `parse`."""
    return lambda data: parse(data.decode("ascii") or "t")


def _socketcand(text: str) -> object:
    identifier, length, *data = text.split()
    return parse_send(identifier, length, data, remote=False)


class _Registers:
    """Registers and coils that accept everything, for panels and for the simulator."""

    def read(self, address: int, count: int) -> Any:
        return [address % 2] * count

    def write(self, address: int, words: Sequence[int]) -> None:
        del address, words

    def read_coils(self, address: int, count: int) -> Sequence[bool]:
        return [bool(address % 2)] * count

    def write_coils(self, address: int, states: Sequence[bool]) -> None:
        del address, states


class _SimulatedRegisters:
    def check_read(self, address: int, count: int) -> None:
        del address, count

    def check_write(self, address: int, count: int) -> None:
        del address, count

    def read(self, address: int, count: int) -> bytes:
        return bytes(2 * count) if address >= 0 else b""

    def write(self, address: int, data: bytes) -> None:
        del address, data


def _panel_request(data: bytes) -> object:
    """Decode as the gateway does: a header of 7 bytes, then as many bytes as it states."""
    if len(data) < HEADER.size:
        raise FramingError("the connection ended")
    request = data[HEADER.size : HEADER.size + body_length(data[: HEADER.size])]
    if not request:
        raise FramingError("the connection ended")
    return answer_panel(request, _Registers())


def _simulator_request(data: bytes) -> object:
    return [answer_request(request, _SimulatedRegisters()) for _, _, request in split_frames(bytearray(data))]


class _Answering:
    """Transport that answers every request with the same bytes."""

    connected, has_checksum = True, False

    def __init__(self, answer: bytes) -> None:
        self._answer = answer

    def open(self) -> None:
        """Do nothing: this transport is always open."""

    def close(self) -> None:
        """Do nothing."""

    def wire_time_s(self, request: bytes) -> float:
        return 0.0 * len(request)

    def ask(self, request: bytes) -> bytes:
        if not self._answer:
            raise LinkTimeout("no answer", **WHERE)
        del request
        return self._answer


def _controller_answer(data: bytes) -> object:
    link = ModbusLink(_Answering(data), writable=[range(1000, 1010)], where=WHERE)
    link.read(1000, 2)
    for ask in (
        lambda: link.write(1000, bytes(4), idempotent=True),
        lambda: link.exchange(1000, bytes(4), 1000, 2, idempotent=False),
    ):
        try:
            ask()
        except ProtocolError:
            continue  # one answer cannot fit all three requests
    return link.read(1000, 2)


class _AnsweringNetwork(canopen.Network):
    """CAN network whose node answers SDO requests with these bytes, eight at a time, and with the last ones again and
    again."""

    def __init__(self, answers: bytes) -> None:
        super().__init__()
        self._answers = [answers[at : at + 8] for at in range(0, max(len(answers), 1), 8)]

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        del data, remote
        if can_id == 0x600 + NODE:
            answer = self._answers.pop(0) if len(self._answers) > 1 else self._answers[0]
            self.notify(0x580 + NODE, bytearray(answer), 0.0)


class _NetworkLink:
    """Link of a drive to such a network."""

    name = "fuzz"

    def __init__(self, answer: bytes) -> None:
        self._network = _AnsweringNetwork(answer)

    def add_node(self, node_id: int, dictionary: canopen.ObjectDictionary) -> canopen.RemoteNode:
        node = canopen.RemoteNode(node_id, dictionary)
        self._network.add_node(node)
        return node

    def check(self) -> None:
        """Do nothing: this link is never lost."""

    @property
    def listeners(self) -> Sequence[can.Listener]:
        return self._network.listeners

    def adapter_status_text(self) -> str:
        return ""


def _drive_answer(data: bytes) -> object:
    return _drive(data[:8]).read(STATUSWORD)


def _drive_text(data: bytes) -> object:
    return _drive(data).read_text(0x1008)


def _drive(answers: bytes) -> DriveNode:
    link: Any = _NetworkLink(answers)
    dictionary = canopen.ObjectDictionary()  # type: ignore[no-untyped-call]
    return DriveNode(link, NODE, "azimuth", dictionary, sdo_timeout_s=0.01)


def _emergency(data: bytes) -> object:
    """Receive the frame as the thread of the bus does, which logs an error and goes on, and read the codes."""
    link: Any = _NetworkLink(b"")
    dictionary = canopen.ObjectDictionary()  # type: ignore[no-untyped-call]
    node = DriveNode(link, NODE, "azimuth", dictionary, sdo_timeout_s=0.01)
    frame = can.Message(arbitration_id=0x80 + NODE, data=data[:8], is_extended_id=False)
    for listener in link.listeners:
        listener.on_message_received(frame)
    return [emergency_text(code) for code in node.take_emergencies()]


async def _accepted(scope: Scope, receive: Receive, send: Send) -> None:
    del scope, receive
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": b""})


def _headers(data: bytes) -> object:
    """Give the headers, one a line, to the access check, which answers each request; a refusal is an HTTPException."""
    lines = [line.partition(b":") for line in data.split(b"\n")]
    headers = [(name.strip().lower(), value.strip()) for name, _, value in lines]
    scope = {"type": "http", "path": "/api/status", "method": "GET", "headers": headers}
    statuses: list[int] = []

    async def send(message: Message) -> None:
        if message["type"] == "http.response.start":
            statuses.append(message["status"])

    async def receive() -> Message:
        return {"type": "http.request", "body": b""}

    _without_waiting(Guard(_accepted, ())(scope, receive, send))
    (status,) = statuses
    if status >= HTTPStatus.BAD_REQUEST:
        raise HTTPException(status)
    return EVENT_NUMBER.fullmatch(Headers(scope=scope).get("last-event-id", ""))


def _without_waiting(call: Awaitable[None]) -> None:
    """Carry out a call that waits for nothing. An event loop for each would take longer than the call."""
    steps = call.__await__()
    try:
        next(steps)
    except StopIteration:
        return
    raise RuntimeError("the call waits")


def _drive_request(data: bytes) -> object:
    entries = {
        (0x6041, 0): ObjectEntry("H", lambda: 0x0637, lambda _: None),
        (0x1008, 0): ObjectEntry("", lambda: "drive"),
    }
    server = SdoServer(entries)
    return [server.answer(data[at : at + 8]) for at in range(0, len(data), 8)]


def _grbl_line(data: bytes) -> object:
    line = parse_line(data)
    return ControllerSettings.of([line]) if isinstance(line, (MessageLine, SettingLine)) else line


class _ScriptedBridge(BridgeLink):
    """Link to a bridge process that sends one line and is silent afterwards."""

    def __init__(self, line: bytes) -> None:
        super().__init__([], response_timeout_s=1.0, watchdog_timeout_s=1.0, heartbeat_timeout_s=1.0, device="cnc")
        self._lines = [line]

    def _send(self, request: dict[str, Any]) -> None:
        del request

    def _line(self, ends_s: float) -> bytes:
        if not self._lines:
            raise LinkTimeout(f"no answer until {ends_s:g} s", **self.where)
        return self._lines.pop()


def _bridge_line(data: bytes) -> object:
    link = _ScriptedBridge(data)
    return parse_snapshot(link.ask("status"), 1.0, link.where)
