"""Bytes on the wire against the golden frames of docs/reference/modbus-register-map.md.

A scripted TCP server knows only the document's hexadecimal text: it records requests and sends the given answers.
"""

from __future__ import annotations

import re
import socket
import threading
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from waiting import PATIENCE_S, SILENCE_S

from drivers.clock import VirtualClock
from drivers.errors import ConfigurationError, LinkLost, LinkTimeout, ProtocolError
from drivers.links.modbus import ModbusLink
from drivers.links.modbus_tcp import TcpEndpoint, TcpTransport
from drivers.modbus_cnc.codec import NumberFormat
from drivers.modbus_cnc.codes import CommandCode
from drivers.modbus_cnc.registers import BlockLayouts, CommandBlock
from drivers.modbus_cnc.session import ModbusSession
from drivers.modbus_cnc.settings import BlockAddresses, ModbusCncSettings
from drivers.modbus_cnc.store import crc32, table_bytes, table_descriptor
from drivers.roles import Permission, TableImage

DOCUMENT = Path(__file__).parents[2] / "docs/reference/modbus-register-map.md"


def golden_frames() -> dict[str, bytes]:
    """Return the hexadecimal blocks of section 10 by their letter."""
    section = DOCUMENT.read_text(encoding="utf-8").split("## 10 Golden frames")[1]
    blocks = re.findall(r"^\*\*([A-G])\*\*.*?^```\n(.*?)^```", section, re.MULTILINE | re.DOTALL)
    return {letter: bytes.fromhex(text) for letter, text in blocks}


GOLDEN = golden_frames()


class Script:
    """Server that answers request n with `answers[n]`; None gives no answer, b"" closes the connection."""

    def __init__(self, answers: list[bytes | None]) -> None:
        self.requests: list[bytes] = []
        self._answers = answers
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        connection, _ = self._listener.accept()
        with connection:
            for answer in self._answers:
                self.requests.append(connection.recv(1024))
                if answer == b"":
                    return
                if answer is not None:
                    connection.sendall(answer)
            connection.recv(1)  # until the client closes

    def close(self) -> None:
        self._listener.close()
        self._thread.join(5.0)

    @property
    def functions(self) -> list[int]:
        return [request[7] for request in self.requests]


def answer(transaction: int, pdu: str) -> bytes:
    body = bytes.fromhex(pdu)
    return bytes([0, transaction, 0, 0, 0, len(body) + 1, 1]) + body


@pytest.fixture
def script(request: pytest.FixtureRequest) -> Iterator[Script]:
    with closing(Script(request.param)) as server:
        yield server


def link_at(port: int, retries: int = 0, timeout_s: float = PATIENCE_S) -> ModbusLink:
    endpoint = TcpEndpoint("127.0.0.1", port, 1)
    where = {"device": "cnc", "link": str(endpoint)}
    transport = TcpTransport(endpoint, timeout_s=timeout_s, where=where)
    return ModbusLink(transport, writable=BlockAddresses().writable(), where=where, retries=retries)


def link_to(script: Script, retries: int = 0, timeout_s: float = PATIENCE_S) -> ModbusLink:
    link = link_at(script.port, retries, timeout_s)
    link.open()
    return link


def status_answer(transaction: int) -> bytes:
    """Return frame D with another transaction number."""
    return transaction.to_bytes(2, "big") + GOLDEN["D"][2:]


@pytest.mark.parametrize("script", [[answer(1, "03 8C" + GOLDEN["D"].hex()[18:]), status_answer(2)]], indirect=True)
def test_status_and_heartbeat_requests_are_the_golden_ones(script: Script) -> None:
    with closing(link_to(script)) as link:
        session = ModbusSession(link, VirtualClock(), ModbusCncSettings(host="127.0.0.1"))
        session.read_status_unchecked()
        session._heartbeat = 6
        session._results = {7: 1}
        session.poll()
    assert script.requests == [GOLDEN["A"], GOLDEN["B"]]


@pytest.mark.parametrize(
    "script",
    [[answer(1, "03 8C" + GOLDEN["D"].hex()[18:]), status_answer(2), status_answer(3)]],
    indirect=True,
)
def test_a_touch_command_is_the_golden_one_and_its_answer_is_understood(script: Script) -> None:
    with closing(link_to(script)) as link:
        session = ModbusSession(link, VirtualClock(), ModbusCncSettings(host="127.0.0.1"))
        session.read_status_unchecked()
        session._results, session._heartbeat, session._sequence = {7: 1}, 6, 6
        session.poll()
        session._results = {6: 1}
        command = CommandBlock(CommandCode.TOUCH, target=(1000.0, 200.5, -0.25), feed=5.0)
        sequence, status = session.start(command)
    assert script.requests[2] == GOLDEN["C"]
    assert (sequence, status.acknowledge, status.result) == (7, 7, 1)
    assert status.position == (1000.0, 150.0, -0.25)
    assert (status.latch_sequence, status.latch_result) == (6, 1)
    assert status.latched == (999.5, 0.125, -2.0)
    assert (status.active_bank, status.pending_bank, status.block_acknowledge) == (1, 0xFFFF, 1)
    assert (status.bank_states, status.bank_crcs) == ((2, 0), (0xCD808051, 0))
    assert status.temperature_count == 3
    assert status.temperatures[:4] == (20500, 21000, -125, -(2**31))
    assert status.permissions == dict.fromkeys(Permission, True)
    assert (status.heartbeat, status.heartbeat_copy, status.probe_bits) == (0x1234, 0x1234, 3)


@pytest.mark.parametrize("script", [[None, None, None, None, answer(5, "10 0834 0022")]], indirect=True)
def test_the_descriptor_and_its_checksum_are_the_golden_ones(script: Script) -> None:
    counts = np.array([[1, -2, 3], [4, 5, -6]], np.int32).reshape(2, 1, 1, 3)
    table = TableImage((0.0, 0.0, 0.0), (4000.0, 1.0, 1.0), 0.0001, counts)
    crc = crc32(table_bytes(table))
    assert crc == 0xCD808051
    packed = BlockLayouts(NumberFormat()).descriptor.pack(table_descriptor(2, table, crc))
    with closing(link_to(script, timeout_s=SILENCE_S)) as link:
        for _ in range(4):
            with pytest.raises(LinkTimeout):
                link.read(1000, 1)
        link.write(2100, packed, idempotent=True)
    assert script.requests[4] == GOLDEN["F"]


def test_the_checksum_is_that_of_the_document() -> None:
    assert crc32(b"123456789") == 0xCBF43926


@pytest.mark.parametrize("script", [[answer(1, "17 F4" + "00" * 244)]], indirect=True)
def test_the_read_window_request_is_the_golden_one_but_for_its_transaction(script: Script) -> None:
    with closing(link_to(script)) as link:
        window = link.exchange(2400, bytes.fromhex("0002 0001"), 1200, 122, idempotent=True)
    assert script.requests[0][2:] == GOLDEN["G"][2:]
    assert len(window) == 244


@pytest.mark.parametrize("script", [[None, None, None, GOLDEN["E"]]], indirect=True)
def test_the_golden_exception_is_a_typed_error(script: Script) -> None:
    with closing(link_to(script, timeout_s=SILENCE_S)) as link:
        for _ in range(3):
            with pytest.raises(LinkTimeout, match="no answer within"):
                link.read(1000, 1)
        with pytest.raises(ProtocolError, match=r"exception 2, illegal register address .register 2000, device cnc"):
            link.exchange(2000, b"\x00\x07", 1000, 70, idempotent=False)


@pytest.mark.parametrize(
    ("script", "text"),
    [
        ([answer(1, "03 04 0001 0002")], "requested 1 registers, but the answer holds 4 bytes"),
        ([answer(1, "03 04 0001")], "requested 1 registers"),
        ([answer(1, "17 02 0001")], "was answered with function 23"),
        ([answer(1, "63 02 0001")], "cannot be decoded"),
        ([answer(1, "83 04")], "exception 4, device failure"),
        ([answer(1, "83 C8")], "unknown Modbus exception 200.*register 1000, device cnc"),
    ],
    indirect=["script"],
)
def test_answers_that_the_protocol_does_not_allow(script: Script, text: str) -> None:
    with closing(link_to(script)) as link, pytest.raises(ProtocolError, match=text):
        link.read(1000, 1)


@pytest.mark.parametrize(
    ("script", "text"),
    [
        ([answer(1, f"83 {code:02X}")], rf"exception {code}, {name}.*register 1000, device cnc")
        for code, name in {1: "illegal function", 2: "illegal register address", 3: "illegal value or count",
                           4: "device failure", 5: "acknowledge", 7: "negative acknowledge", 8: "memory parity",
                           10: "gateway path", 11: "gateway target"}.items()
    ],
    indirect=["script"],
)  # fmt: skip
def test_each_exception_is_a_typed_error(script: Script, text: str) -> None:
    with closing(link_to(script, retries=2)) as link, pytest.raises(ProtocolError, match=text):
        link.read(1000, 1)
    assert len(script.requests) == 1


@pytest.mark.parametrize(
    "script", [[answer(1, "03 02 002A")[:6] + b"\x02" + answer(1, "03 02 002A")[7:]]], indirect=True
)
def test_another_unit_answering_is_no_answer(script: Script) -> None:
    with (
        closing(link_to(script, timeout_s=SILENCE_S)) as link,
        pytest.raises(LinkTimeout, match="check unit id"),
    ):
        link.read(1000, 1)


@pytest.mark.parametrize("script", [[answer(1, "10 0834 0001")]], indirect=True)
def test_a_write_answered_for_other_registers(script: Script) -> None:
    with closing(link_to(script)) as link, pytest.raises(ProtocolError, match="names other registers"):
        link.write(2100, b"\x00\x01\x00\x02", idempotent=True)


@pytest.mark.parametrize("script", [[None, answer(2, "03 02 002A")]], indirect=True)
def test_a_read_is_asked_again(script: Script) -> None:
    with closing(link_to(script, retries=1, timeout_s=SILENCE_S)) as link:
        assert link.read(1000, 1) == b"\x00\x2a"
    assert script.functions == [3, 3]


@pytest.mark.parametrize("script", [[answer(1, "83 06"), answer(2, "03 02 002A")]], indirect=True)
def test_a_busy_controller_is_asked_again(script: Script) -> None:
    with closing(link_to(script, retries=1)) as link:
        assert link.read(1000, 1) == b"\x00\x2a"


@pytest.mark.parametrize("script", [[None]], indirect=True)
def test_what_is_not_idempotent_is_sent_once(script: Script) -> None:
    with closing(link_to(script, retries=3, timeout_s=SILENCE_S)) as link, pytest.raises(LinkTimeout):
        link.exchange(2000, b"\x00\x07", 1000, 70, idempotent=False)
    assert script.functions == [23]


@pytest.mark.parametrize("script", [[b""]], indirect=True)
def test_a_connection_that_ends_is_lost_and_stays_so(script: Script) -> None:
    with closing(link_to(script, retries=3)) as link:
        with pytest.raises(LinkLost, match=r"register 1000, device cnc, link modbus-tcp 127"):
            link.read(1000, 1)
        with pytest.raises(LinkLost, match="connection lost"):
            link.read(1000, 1)


@pytest.mark.parametrize(("register", "count"), [(1000, 1), (2023, 1), (2022, 2), (1999, 2), (2134, 1)])
def test_registers_outside_the_allow_list_are_never_written(register: int, count: int) -> None:
    link = link_at(1)
    with pytest.raises(ConfigurationError, match="refused to write outside the writable registers"):
        link.write(register, bytes(2 * count), idempotent=True)
    with pytest.raises(ConfigurationError):
        link.exchange(register, bytes(2 * count), 1000, 70, idempotent=True)


def test_nobody_there_is_a_lost_link() -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    link = link_at(port)
    with pytest.raises(LinkLost, match="cannot connect to the Modbus server"):
        link.open()


@pytest.mark.parametrize("script", [[answer(1, "03 02 002A")]], indirect=True)
def test_round_trips_are_measured(script: Script) -> None:
    with closing(link_to(script)) as link:
        link.read(1000, 1)
        assert link.latency.count == 1
        assert 0.0 < link.latency.median_s == link.latency.worst_s < PATIENCE_S
