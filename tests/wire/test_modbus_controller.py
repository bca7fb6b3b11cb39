"""Simulated controller byte by byte: golden frames of docs/reference/modbus-register-map.md, and behaviour in virtual
time.

A raw socket, struct and zlib: no Modbus library and no shared register map.
"""

from __future__ import annotations

import socket
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest
from modbus_fakes import FakeController, FakeLatch, FakeWorld

from drivers.errors import ConfigurationError
from drivers.roles import Activation, MotionState, Permission
from simulators.wire.modbus.controller import ModbusController
from simulators.wire.modbus.numbers import RegisterNumberFormat, ScaledInt32Numbers
from simulators.wire.shared_world import SharedWorld

GOLDEN_A = "00 01 00 00 00 06 01  03 03 E8 00 46"
GOLDEN_B = "00 02 00 00 00 0D 01  17 03 E8 00 46 07 D0 00 01 02  00 07"
GOLDEN_C = """
00 03 00 00 00 39 01  17 03 E8 00 46 07 D0 00 17 2E
00 08 00 0F 00 00 00 00 00 00 00 00
40 8F 40 00 00 00 00 00  40 69 10 00 00 00 00 00  BF D0 00 00 00 00 00 00
40 14 00 00 00 00 00 00  00 07"""
GOLDEN_D = """
00 03 00 00 00 8F 01  17 8C
56 43 01 00 12 34 00 08 00 01 00 00 00 7F 00 03 00 07 00 01 00 07 00 01
40 8F 40 00 00 00 00 00  40 62 C0 00 00 00 00 00  BF D0 00 00 00 00 00 00
00 06 00 01
40 8F 3C 00 00 00 00 00  3F C0 00 00 00 00 00 00  C0 00 00 00 00 00 00 00
00 01 00 00 00 00 00 00 00 00 FF FF 00 01 00 01 00 02 00 00
CD 80 80 51 00 00 00 00
00 03 00 00 50 14 00 00 52 08 FF FF FF 83
80 00 00 00 80 00 00 00 80 00 00 00 80 00 00 00 80 00 00 00  12 34"""
GOLDEN_E = "00 04 00 00 00 03 01  97 02"
GOLDEN_F = """
00 05 00 00 00 4B 01  10 08 34 00 22 44
00 02 00 02 00 01 00 01
00 00 00 00 00 00 00 00  00 00 00 00 00 00 00 00  00 00 00 00 00 00 00 00
40 AF 40 00 00 00 00 00  3F F0 00 00 00 00 00 00  3F F0 00 00 00 00 00 00
3F 1A 36 E2 EB 1C 43 2D  CD 80 80 51"""
GOLDEN_G = "00 06 00 00 00 0F 01  17 04 B0 00 7A 09 60 00 02 04  00 02 00 01"

CRC_F = 0xCD808051
COUNTS_F = (1, -2, 3, 4, 5, -6)


class Peer:
    """Client that knows frames and addresses only as numbers."""

    def __init__(self, address: tuple[str, int]) -> None:
        self.socket = socket.create_connection(address, timeout=600.0)
        self.sequence = 0
        self.heartbeat = 0

    def send(self, frame: str | bytes) -> None:
        self.socket.sendall(bytes.fromhex(frame) if isinstance(frame, str) else frame)

    def receive(self) -> bytes:
        header = self._exactly(7)
        return header + self._exactly(int.from_bytes(header[4:6], "big") - 1)

    def _exactly(self, count: int) -> bytes:
        data = b""
        while len(data) < count:
            chunk = self.socket.recv(count - len(data))
            if not chunk:
                raise ConnectionResetError
            data += chunk
        return data

    def exchange(self, frame: str | bytes) -> bytes:
        self.send(frame)
        return self.receive()

    def pdu(self, request: bytes) -> bytes:
        return self.exchange(struct.pack(">HHHB", 99, 0, len(request) + 1, 1) + request)[7:]

    def read(self, address: int, count: int) -> bytes:
        answer = self.pdu(struct.pack(">BHH", 3, address, count))
        assert answer[:2] == bytes((3, 2 * count)), answer.hex(" ")
        return answer[2:]

    def word(self, address: int) -> int:
        return int.from_bytes(self.read(address, 1), "big")

    def words(self, address: int, count: int) -> tuple[int, ...]:
        return struct.unpack(f">{count}H", self.read(address, count))

    def doubles(self, address: int, count: int) -> tuple[float, ...]:
        return struct.unpack(f">{count}d", self.read(address, 4 * count))

    def write(self, address: int, data: bytes) -> None:
        answer = self.pdu(struct.pack(">BHHB", 16, address, len(data) // 2, len(data)) + data)
        assert answer == struct.pack(">BHH", 16, address, len(data) // 2), answer.hex(" ")

    def beat(self) -> None:
        self.heartbeat = self.heartbeat % 65535 + 1
        self.write(2000, struct.pack(">H", self.heartbeat))

    def command(
        self,
        code: int,
        target: tuple[float, float, float] = (0.0, 0.0, 0.0),
        feed: float = 0.0,
        *,
        bank: int = 0,
        nonce: int = 0,
        crc: int = 0,
    ) -> int:
        """Send one command with the next sequence number and return the result, 1 for accepted."""
        self.sequence = self.sequence % 65535 + 1
        self.heartbeat = self.heartbeat % 65535 + 1
        block = struct.pack(">4HI4dH", self.heartbeat, code, bank, nonce, crc, *target, feed, self.sequence)
        self.write(2000, block)
        acknowledge, result = self.words(1008, 2)
        assert acknowledge == self.sequence
        return result

    def motion(self) -> tuple[int, int, int, int]:
        """Return state, fault code, motion sequence and motion outcome."""
        state, fault = self.words(1004, 2)
        sequence, outcome = self.words(1010, 2)
        return state, fault, sequence, outcome

    def block(self, number: int, counts: tuple[int, ...]) -> tuple[int, int]:
        """Send one data block; return block acknowledge and block result."""
        filled = counts + (0,) * (60 - len(counts))
        self.write(2200, struct.pack(">60iH", *filled, number))
        acknowledge, result = self.words(1044, 2)
        return acknowledge, result


@dataclass
class Rig:
    controller: FakeController
    shared: SharedWorld[FakeWorld]
    server: ModbusController
    peer: Peer

    def advance(self, seconds: float) -> None:
        self.shared.advance_to(self.shared.now + seconds)

    def advance_beating(self, seconds: float) -> None:
        """Advance time with the agent's heartbeat alive, in steps of 0.25 s, which is exact in binary."""
        for _ in range(round(seconds / 0.25)):
            self.advance(0.25)
            self.peer.beat()


@pytest.fixture
def rig() -> Iterator[Rig]:
    yield from _rig(FakeController())


def _rig(controller: FakeController, numbers: RegisterNumberFormat | None = None) -> Iterator[Rig]:
    shared = SharedWorld(FakeWorld(controller))
    server = ModbusController(shared, ("127.0.0.1", 0), numbers)
    server.start()
    peer = Peer(server.address)
    try:
        yield Rig(controller, shared, server, peer)
    finally:
        peer.socket.close()
        server.close()


def write_table_f(peer: Peer, bank: int, *, activate: bool = False) -> None:
    """Write the table of golden frame F to `bank`, with at most five commands."""
    descriptor = bytearray(bytes.fromhex(GOLDEN_F)[13:])
    descriptor[1] = bank
    peer.write(2100, bytes(descriptor))
    assert peer.command(31, bank=bank) == 1
    assert peer.block(1, COUNTS_F) == (1, 1)
    assert peer.command(32, bank=bank, crc=CRC_F) == 1
    if activate:
        assert peer.command(33, bank=bank, crc=CRC_F) == 1
        assert peer.command(34, bank=bank, nonce=peer.word(1042)) == 1


# golden frames


def test_status_after_power_up(rig: Rig) -> None:
    answer = rig.peer.exchange(GOLDEN_A)
    assert answer[:9] == bytes.fromhex("00 01 00 00 00 8F 01 03 8C")
    words = struct.unpack(">70H", answer[9:])
    assert words[:4] == (0x5643, 0x0100, 1, 0)
    assert words[4:12] == (0, 0, 0x7F, 3, 0, 0, 0, 0)
    assert words[24:26] == (0, 0)
    assert words[38:52] == (0, 0, 0, 0, 0, 0xFFFF, 0, 0, 0, 0, 0, 0, 0, 0)
    assert words[69] == words[2]


def test_heartbeat_and_status_in_one_request(rig: Rig) -> None:
    answer = rig.peer.exchange(GOLDEN_B)
    assert answer[:9] == bytes.fromhex("00 02 00 00 00 8F 01 17 8C")
    assert answer[9 + 6 : 9 + 8] == bytes.fromhex("00 07")


def test_touch_is_answered_by_the_golden_status(rig: Rig) -> None:
    """Frames C and D with the whole history contained in D: table in bank 1, touch 6, then touch 7."""
    peer, controller = rig.peer, rig.controller
    write_table_f(peer, 1, activate=True)  # sequences 1 to 4
    assert peer.command(23) == 1
    controller.wall_y = 0.125
    controller.position = np.array([999.5, 0.0, -2.0])
    assert peer.command(15, (999.5, 1.0, -2.0), 5.0) == 1  # sequence 6
    rig.advance(0.5)
    controller.wall_y = None
    controller.position = np.array([1000.0, 150.0, -0.25])
    peer.heartbeat = 7
    heartbeat = peer.word(1002)
    for _ in range(0x1234 - heartbeat - 1):
        peer.read(1002, 1)
    assert peer.exchange(GOLDEN_C).hex(" ") == bytes.fromhex(GOLDEN_D).hex(" ")
    assert controller.orders[-1] == ("touch", [1000.0, 200.5, -0.25], 5.0)


def test_illegal_address_is_exception_2(rig: Rig) -> None:
    assert rig.peer.exchange("00 04 00 00 00 0D 01  17 03 E8 00 47 07 D0 00 01 02 00 07") == bytes.fromhex(GOLDEN_E)
    assert rig.peer.word(1003) == 0  # nothing was written either


def test_descriptor_and_table_read_back(rig: Rig) -> None:
    peer = rig.peer
    assert peer.exchange(GOLDEN_F) == bytes.fromhex("00 05 00 00 00 06 01 10 08 34 00 22")
    assert peer.command(31, bank=2) == 1
    assert peer.block(1, COUNTS_F) == (1, 1)
    assert peer.command(32, bank=2, crc=CRC_F) == 1
    answer = peer.exchange(GOLDEN_G)
    assert answer[:9] == bytes.fromhex("00 06 00 00 00 F7 01 17 F4")
    assert struct.unpack(">2H60i", answer[9:]) == (2, 1, *COUNTS_F, *([0] * 54))
    peer.write(2400, struct.pack(">2H", 2, 0))
    window = peer.read(1200, 122)
    assert window[:4] == bytes.fromhex("00 02 00 00")
    assert window[4:72] == bytes.fromhex(GOLDEN_F)[13:]
    assert not any(window[72:])


# frames and addresses


def test_requests_in_pieces_and_several_at_once(rig: Rig) -> None:
    frame = bytes.fromhex(GOLDEN_A)
    for byte in frame:
        rig.peer.send(bytes([byte]))
    assert rig.peer.receive()[:2] == b"\x00\x01"
    rig.peer.send(frame + bytes.fromhex(GOLDEN_B) + frame)
    assert [rig.peer.receive()[7] for _ in range(3)] == [3, 0x17, 3]


@pytest.mark.parametrize(
    ("request_hex", "answer_hex"),
    [
        ("01 00 00 00 01", "81 01"),  # read coils
        ("04 03 E8 00 01", "84 01"),  # input registers
        ("06 07 D0 00 01", "86 01"),  # write single
        ("2B 0E 01 00", "AB 01"),
        ("03 03 E7 00 01", "83 02"),  # 999
        ("03 03 E8 00 47", "83 02"),  # one past STATUS
        ("03 04 2D 00 01", "83 02"),  # 1069
        ("03 04 2E 00 01", "83 02"),  # 1070
        ("03 04 8A 00 02", "83 02"),  # 1162 and one more
        ("03 FF FF 00 02", "83 02"),
        ("03 03 E8 00 00", "83 03"),
        ("03 03 E8 00 7E", "83 03"),
        ("03 03 E8", "83 03"),
        ("10 03 E8 00 01 02 00 01", "90 02"),  # STATUS is not written
        ("10 04 B0 00 01 02 00 01", "90 02"),  # nor READ WINDOW
        ("10 07 E6 00 02 04 00 01 00 01", "90 02"),  # 2022 and one more
        ("10 07 D0 00 01 04 00 01", "90 03"),
        ("10 07 D0 00 02 04 00 01", "90 03"),
        ("10 07 D0 00 00 00", "90 03"),
        ("17 03 E8 00 46 03 E8 00 01 02 00 07", "97 02"),
        ("17 03 E8 00 00 07 D0 00 01 02 00 07", "97 03"),
        ("17 03 E8 00 46 07 D0 00 01 02", "97 03"),
    ],
)
def test_exceptions(rig: Rig, request_hex: str, answer_hex: str) -> None:
    if request_hex.startswith("03 04 2D"):
        answer_hex = "03 02 00 01"  # the last register of STATUS: heartbeat copy of the first image
    assert rig.peer.pdu(bytes.fromhex(request_hex)) == bytes.fromhex(answer_hex)


def test_most_registers_a_write_may_carry(rig: Rig) -> None:
    """The frame could carry 123 registers; the page allows 121, the DATA WINDOW."""
    rig.peer.write(2200, bytes(242))
    assert rig.peer.pdu(struct.pack(">BHHB", 16, 2200, 122, 244) + bytes(244)) == b"\x90\x03"


def test_another_unit_is_not_answered(rig: Rig) -> None:
    rig.peer.send("00 01 00 00 00 06 02 03 03 E8 00 01")
    assert rig.peer.exchange("00 02 00 00 00 06 01 03 03 E8 00 01")[:2] == b"\x00\x02"


@pytest.mark.parametrize("garbage", ["00 01 00 01 00 06 01 03 03 E8 00 01", "00 01 00 00 FF FF 01 03"])
def test_what_is_no_modbus_ends_the_connection(rig: Rig, garbage: str) -> None:
    rig.peer.send(garbage)
    with pytest.raises(ConnectionResetError):
        rig.peer.receive()
    again = Peer(rig.server.address)
    assert again.word(1000) == 0x5643
    again.socket.close()


def test_second_client_waits_for_its_turn(rig: Rig) -> None:
    second = Peer(rig.server.address)
    second.send(GOLDEN_A)
    assert rig.peer.word(1000) == 0x5643
    rig.peer.socket.close()
    assert second.receive()[7] == 3
    second.socket.close()


def test_limits(rig: Rig) -> None:
    assert rig.peer.doubles(1100, 12) == (0, 0, -10, 4000, 1300, 1500, *[200] * 3, *[1000] * 3)
    assert rig.peer.words(1148, 4) == (2, 20, 10, 10)
    assert rig.peer.words(1152, 2) == (0, 1000)
    assert rig.peer.doubles(1154, 2) == (0.0001, 1.0)
    assert rig.peer.word(1162) == 0


def test_heartbeat_of_the_controller_counts_images(rig: Rig) -> None:
    first = rig.peer.word(1002)
    image = rig.peer.words(1000, 70)
    assert image[2] == image[69] == first + 1


# motion


def test_move_feed_reaches_its_target(rig: Rig) -> None:
    assert rig.peer.command(12, (100.0, 0.0, 0.0), 50.0) == 1
    assert rig.peer.motion() == (1, 0, 1, 1)
    rig.advance_beating(1.5)
    assert rig.peer.doubles(1012, 3) == (75.0, 0.0, 0.0)
    rig.advance_beating(0.5)
    assert rig.peer.motion() == (0, 0, 1, 2)
    assert rig.controller.orders == [("move", [100.0, 0.0, 0.0], 50.0)]


def test_rapid_and_guarded_orders(rig: Rig) -> None:
    for code, kind, feed in ((11, "move", None), (13, "guarded", None), (14, "guarded", 20.0)):
        assert rig.peer.command(code, (1.0, 2.0, 3.0), feed or 0.0) == 1
        assert rig.controller.orders[-1] == (kind, [1.0, 2.0, 3.0], feed)
        assert rig.peer.command(23) == 1


def test_touch_missed_tells_where_it_ended(rig: Rig) -> None:
    assert rig.peer.command(15, (0.0, 5.0, 0.0), 10.0) == 1
    assert rig.peer.words(1024, 2) == (0, 0)
    rig.advance(0.5)
    assert rig.peer.motion() == (0, 0, 1, 4)
    assert rig.peer.words(1024, 2) == (1, 2)
    assert rig.peer.doubles(1026, 3) == (0.0, 5.0, 0.0)


def test_latch_belongs_to_the_touch_and_outlasts_later_moves(rig: Rig) -> None:
    rig.controller.latch = FakeLatch(41, np.array([9.0, 9.0, 9.0]))  # of before this client's time
    rig.controller.wall_y = 4.0
    assert rig.peer.command(15, (0.0, 10.0, 0.0), 10.0) == 1
    rig.advance(0.75)
    assert rig.peer.motion() == (0, 0, 1, 3)
    rig.controller.wall_y = None
    assert rig.peer.command(12, (0.0, 0.0, 0.0), 10.0) == 1
    rig.advance(0.5)
    assert rig.peer.words(1024, 2) == (1, 1)
    assert rig.peer.doubles(1026, 3) == (0.0, 4.0, 0.0)
    assert rig.peer.motion()[2:] == (2, 2)


def test_guard_trip_is_a_fault_until_reset(rig: Rig) -> None:
    rig.controller.wall_y = 4.0
    assert rig.peer.command(14, (0.0, 10.0, 0.0), 10.0) == 1
    rig.advance(0.75)
    assert rig.peer.motion() == (3, 5, 1, 5)
    assert rig.peer.command(12, (0.0, 0.0, 0.0), 10.0) == 3
    assert rig.peer.command(23) == 1
    assert rig.peer.motion() == (3, 5, 1, 5)
    assert rig.peer.command(24) == 1
    assert rig.peer.motion() == (0, 0, 1, 5)


def test_collision_has_its_own_fault_code(rig: Rig) -> None:
    assert rig.peer.command(12, (0.0, 10.0, 0.0), 10.0) == 1
    rig.controller.motion, rig.controller.fault = MotionState.FAULT, "collision of stem and bar"
    assert rig.peer.motion() == (3, 10, 1, 8)


def test_hold_resume_and_stop(rig: Rig) -> None:
    assert rig.peer.command(12, (100.0, 0.0, 0.0), 50.0) == 1
    rig.advance(0.5)
    assert rig.peer.command(21) == 1
    rig.advance(60.0)  # held is not watched
    assert rig.peer.motion() == (2, 0, 1, 1)
    assert rig.peer.command(12, (0.0, 0.0, 0.0), 50.0) == 3
    assert rig.peer.command(24) == 3
    assert rig.peer.command(22) == 1
    rig.advance(0.5)
    assert rig.peer.motion() == (1, 0, 1, 1)
    assert rig.peer.doubles(1012, 1) == (50.0,)
    assert rig.peer.command(23) == 1
    assert rig.peer.motion() == (0, 0, 1, 6)


def test_stop_ends_a_held_motion_and_nothing_else(rig: Rig) -> None:
    assert rig.peer.command(23) == 1
    assert rig.peer.motion() == (0, 0, 0, 0)
    assert rig.peer.command(11, (100.0, 0.0, 0.0)) == 1
    assert rig.peer.command(21) == 1
    assert rig.peer.command(23) == 1
    assert rig.peer.motion() == (0, 0, 2, 6)


@pytest.mark.parametrize(
    ("code", "target", "feed", "result"),
    [
        (99, (0.0, 0.0, 0.0), 1.0, 2),
        (12, (4000.1, 0.0, 0.0), 1.0, 5),
        (12, (0.0, 0.0, -10.1), 1.0, 5),
        (12, (1.0, 0.0, 0.0), 0.0, 6),
        (12, (1.0, 0.0, 0.0), -1.0, 6),
        (12, (1.0, 0.0, 0.0), 1e6, 6),
        (12, (float("nan"), 0.0, 0.0), 1.0, 7),
        (12, (1.0, 0.0, 0.0), float("inf"), 7),
    ],
)
def test_motion_refused(rig: Rig, code: int, target: tuple[float, float, float], feed: float, result: int) -> None:
    assert rig.peer.command(code, target, feed) == result
    assert rig.peer.motion() == (0, 0, 0, 0)
    assert rig.controller.orders == []


def test_every_permission_has_its_bit_and_is_needed(rig: Rig) -> None:
    order = ["AUTOMATIC", "DOORS_CLOSED", "SPINDLE_STOPPED", "PROGRAM_IDLE", "REFERENCED", "NO_FAULT", "CONSENT"]
    for bit, name in enumerate(order):
        rig.controller.granted = dict.fromkeys(Permission, True) | {Permission[name]: False}
        assert rig.peer.word(1006) == 0x7F & ~(1 << bit)
        assert rig.peer.command(11, (1.0, 1.0, 1.0)) == 4


def test_probe_conditions(rig: Rig) -> None:
    controller, peer = rig.controller, rig.peer
    controller.probe_deflected = True
    assert peer.word(1007) == 0b111
    assert peer.command(15, (0.0, 1.0, 0.0), 1.0) == 10
    controller.probe_deflected, controller.probe_healthy = False, False
    assert peer.word(1007) == 0b001
    assert peer.command(15, (0.0, 1.0, 0.0), 1.0) == 8
    assert peer.command(13, (0.0, 1.0, 0.0)) == 8
    assert peer.command(11, (0.0, 1.0, 0.0)) == 1


def test_probe_lost_in_a_guarded_move(rig: Rig) -> None:
    assert rig.peer.command(13, (0.0, 100.0, 0.0)) == 1
    rig.controller.probe_healthy = False
    rig.advance(0.125)
    assert rig.peer.motion() == (3, 9, 1, 8)
    assert rig.peer.command(24) == 9
    rig.controller.probe_healthy = True
    assert rig.peer.command(24) == 1
    assert rig.peer.motion()[:2] == (0, 0)


def test_door_opened_while_moving(rig: Rig) -> None:
    assert rig.peer.command(11, (100.0, 0.0, 0.0)) == 1
    rig.controller.granted[Permission.DOORS_CLOSED] = False
    rig.advance(0.125)
    assert rig.peer.motion() == (3, 7, 1, 8)
    assert rig.peer.word(1006) == 0x7F & ~0b100010
    assert rig.peer.command(24) == 9


# sequence and watchdog


def test_the_same_sequence_is_taken_once(rig: Rig) -> None:
    frame = bytes.fromhex(GOLDEN_C)
    rig.peer.exchange(frame)
    rig.peer.exchange(frame)
    rig.peer.exchange(frame)
    assert len(rig.controller.orders) == 1
    assert rig.peer.words(1008, 4) == (7, 1, 7, 1)


def test_sequence_zero_is_no_command(rig: Rig) -> None:
    rig.peer.write(2000, struct.pack(">4HI4dH", 1, 11, 0, 0, 0, 1.0, 1.0, 1.0, 0.0, 0))
    assert rig.peer.words(1008, 4) == (0, 0, 0, 0)
    assert rig.controller.orders == []


def test_command_is_complete_with_its_last_register(rig: Rig) -> None:
    block = struct.pack(">4HI4dH", 1, 12, 0, 0, 0, 7.0, 8.0, 9.0, 10.0, 3)
    rig.peer.write(2000, block[:20])
    rig.peer.write(2010, block[20:44])
    assert rig.controller.orders == []
    rig.peer.write(2022, block[44:])
    assert rig.controller.orders == [("move", [7.0, 8.0, 9.0], 10.0)]


def test_motion_sequence_is_left_alone_by_other_commands(rig: Rig) -> None:
    assert rig.peer.command(12, (100.0, 0.0, 0.0), 10.0) == 1
    assert rig.peer.command(21) == 1
    assert rig.peer.command(12, (1.0, 0.0, 0.0), 10.0) == 3  # refused: not a motion
    assert rig.peer.words(1008, 4) == (3, 3, 1, 1)


def test_heartbeat_lost_stops_motion_after_one_second_however_far_time_jumps(rig: Rig) -> None:
    assert rig.peer.command(12, (1000.0, 0.0, 0.0), 10.0) == 1
    rig.advance(0.5)
    rig.peer.beat()
    rig.advance(30.0)
    assert rig.peer.motion() == (3, 6, 1, 7)
    assert rig.peer.doubles(1012, 1) == (15.0,)
    assert rig.peer.word(1006) == 0x7F & ~0b100000
    assert rig.peer.command(24) == 1
    assert rig.peer.motion() == (0, 0, 1, 7)


def test_rewriting_the_same_heartbeat_is_no_life_sign(rig: Rig) -> None:
    assert rig.peer.command(12, (1000.0, 0.0, 0.0), 10.0) == 1
    for _ in range(4):
        rig.advance(0.25)
        rig.peer.write(2000, struct.pack(">H", rig.peer.heartbeat))
    assert rig.peer.motion() == (3, 6, 1, 7)


def test_idle_is_not_watched_and_a_command_starts_the_second_anew(rig: Rig) -> None:
    rig.advance(100.0)
    assert rig.peer.command(12, (1000.0, 0.0, 0.0), 10.0) == 1
    rig.advance(0.875)
    assert rig.peer.motion() == (1, 0, 1, 1)


# tables


def test_bank_states_and_crc(rig: Rig) -> None:
    write_table_f(rig.peer, 2)
    assert rig.peer.words(1038, 6) == (0, 2, 0, 0, 0, 0xFFFF)
    assert rig.peer.words(1046, 2) == (0, 2)
    assert struct.unpack(">2I", rig.peer.read(1048, 4)) == (0, CRC_F)
    table = rig.controller.banks[2]
    assert table.counts.shape == (2, 1, 1, 3)
    assert table.counts.ravel().tolist() == list(COUNTS_F)
    assert (table.origin_mm, table.step_mm, table.resolution_mm) == ((0, 0, 0), (4000, 1, 1), 0.0001)


def test_table_of_many_blocks_x_slowest(rig: Rig) -> None:
    """3 × 2 × 7 = 42 nodes need three blocks, the last with 6 counts."""
    counts = [((7 * i) % 19) - 9 for i in range(126)]
    crc = zlib.crc32(b"".join(c.to_bytes(4, "big", signed=True) for c in counts))
    grid = (10.0, 20.0, 30.0, 100.0, 200.0, 50.0, 0.0001)
    rig.peer.write(2100, struct.pack(">4H7dI", 1, 3, 2, 7, *grid, crc))
    assert rig.peer.command(31, bank=1) == 1
    for number in (1, 2, 3):
        assert rig.peer.block(number, tuple(counts[60 * (number - 1) : 60 * number])) == (number, 1)
    assert rig.peer.block(4, ()) == (3, 23)
    assert rig.peer.command(32, bank=1, crc=crc) == 1
    table = rig.controller.banks[1]
    for x in range(3):
        for y in range(2):
            for z in range(7):
                start = 3 * (z + 7 * (y + 2 * x))
                assert table.counts[x, y, z].tolist() == counts[start : start + 3]
    rig.peer.write(2400, struct.pack(">2H", 1, 3))
    assert struct.unpack(">2H60i", rig.peer.read(1200, 122)) == (1, 3, *counts[120:], *[0] * 54)
    rig.peer.write(2400, struct.pack(">2H", 1, 4))
    assert rig.peer.words(1200, 2) == (1, 0xFFFF)


def test_blocks_sent_again_out_of_order_and_too_large(rig: Rig) -> None:
    peer = rig.peer
    assert peer.block(1, COUNTS_F) == (0, 27)
    peer.write(2100, struct.pack(">4H7dI", 1, 20, 2, 1, *[0.0] * 3, *[1.0] * 3, 0.0001, 0))
    assert peer.command(31, bank=1) == 1
    assert peer.words(1044, 2) == (0, 0)
    assert peer.word(2320) == 0
    assert peer.command(32, bank=1) == 23
    assert peer.block(2, COUNTS_F) == (0, 23)
    assert peer.block(1, (10001,)) == (0, 7)  # 1 mm is 10 000 counts
    assert peer.block(1, (-(2**31),)) == (0, 7)
    assert peer.block(1, (-10000,)) == (1, 1)
    assert peer.block(1, (5,)) == (1, 1)  # the same number again: nothing happens
    assert peer.block(2, ()) == (2, 1)
    stored = struct.pack(">120i", -10000, *[0] * 119)
    assert peer.command(32, bank=2, crc=zlib.crc32(stored)) == 27
    assert peer.command(32, bank=1, crc=zlib.crc32(stored)) == 24  # the descriptor says otherwise
    assert peer.words(1046, 2) == (3, 0)
    assert peer.word(1040) == 0
    assert 1 not in rig.controller.banks


@pytest.mark.parametrize(
    ("bank", "descriptor", "result"),
    [
        (0, (0, 2, 1, 1, 0, 0, 0, 1, 1, 1, 0.0001, 0), 20),
        (3, (3, 2, 1, 1, 0, 0, 0, 1, 1, 1, 0.0001, 0), 20),
        (2, (1, 2, 1, 1, 0, 0, 0, 1, 1, 1, 0.0001, 0), 22),
        (2, (2, 21, 1, 1, 0, 0, 0, 1, 1, 1, 0.0001, 0), 22),
        (2, (2, 0, 1, 1, 0, 0, 0, 1, 1, 1, 0.0001, 0), 22),
        (2, (2, 20, 10, 6, 0, 0, 0, 1, 1, 1, 0.0001, 0), 22),
        (2, (2, 2, 1, 1, 0, 0, 0, 0, 1, 1, 0.0001, 0), 22),
        (2, (2, 2, 1, 1, 0, 0, 0, 1, 1, 1, 0.0002, 0), 22),
        (2, (2, 2, 1, 1, float("nan"), 0, 0, 1, 1, 1, 0.0001, 0), 7),
        (2, (2, 2, 1, 1, 0, 0, 0, 1, 0, -1, 0.0001, 0), 1),
    ],
)
def test_begin_refused(rig: Rig, bank: int, descriptor: tuple[float, ...], result: int) -> None:
    rig.peer.write(2100, struct.pack(">4H7dI", *descriptor))
    assert rig.peer.command(31, bank=bank) == result
    assert rig.peer.word(1040) == (bank if result == 1 else 0)


def test_active_bank_is_not_opened(rig: Rig) -> None:
    peer = rig.peer
    write_table_f(peer, 1, activate=True)
    assert peer.command(31, bank=1) == 21
    assert peer.words(1046, 2) == (2, 0)


def test_bank_open_for_writing_is_not_readable(rig: Rig) -> None:
    peer = rig.peer
    write_table_f(peer, 2)
    assert peer.command(31, bank=2) == 1
    assert peer.words(1039, 2) == (0, 2)
    assert peer.words(1046, 2) == (0, 1)
    for block, window in ((0, (2, 0, 2)), (1, (2, 0xFFFF, 0))):
        peer.write(2400, struct.pack(">2H", 2, block))
        assert peer.words(1200, 122) == window + (0,) * 119
    assert peer.command(33, bank=2, crc=CRC_F) == 26


def test_interrupted_transfer_leaves_a_damaged_bank(rig: Rig) -> None:
    peer = rig.peer
    for bank in (1, 2):
        peer.write(2100, struct.pack(">4H7dI", bank, 2, 1, 1, *[0.0] * 3, *[1.0] * 3, 0.0001, 0))
        assert peer.command(31, bank=bank) == 1
    assert peer.words(1046, 2) == (3, 1)


def test_activation_in_two_steps(rig: Rig) -> None:
    peer = rig.peer
    write_table_f(peer, 2)
    assert peer.command(34, bank=2, nonce=0) == 25
    assert peer.command(33, bank=2, crc=CRC_F ^ 1) == 24
    assert peer.command(33, bank=1, crc=0) == 26
    assert peer.command(33, bank=7) == 20
    assert peer.command(33, bank=2, crc=CRC_F) == 1
    bank, nonce = peer.words(1041, 2)
    assert bank == 2
    assert nonce != 0
    assert peer.command(34, bank=1, nonce=nonce) == 25
    assert peer.command(34, bank=2, nonce=nonce ^ 1) == 25
    assert peer.command(34, bank=2, nonce=nonce) == 1
    assert peer.words(1038, 5) == (2, 0, 0, 0, 0)
    assert peer.command(34, bank=2, nonce=nonce) == 25
    assert peer.command(33, bank=0, crc=1) == 24
    assert peer.command(33, bank=0, crc=0) == 1
    assert peer.word(1042) not in (0, nonce)
    assert peer.command(34, bank=0, nonce=peer.word(1042)) == 1
    assert rig.controller.active_bank == 0


def test_armed_for_five_seconds(rig: Rig) -> None:
    write_table_f(rig.peer, 1)
    for wait_s, result in ((5.0, 1), (5.125, 25)):
        assert rig.peer.command(33, bank=1, crc=CRC_F) == 1
        nonce = rig.peer.word(1042)
        rig.advance(wait_s)
        assert rig.peer.word(1042) == (nonce if result == 1 else 0)
        assert rig.peer.command(34, bank=1, nonce=nonce) == result


def test_table_commands_need_idle_and_disarm(rig: Rig) -> None:
    write_table_f(rig.peer, 1)
    assert rig.peer.command(33, bank=1, crc=CRC_F) == 1
    write_table_f(rig.peer, 2)
    assert rig.peer.word(1042) == 0
    assert rig.peer.command(11, (100.0, 0.0, 0.0)) == 1
    for code in (31, 32, 33, 34):
        assert rig.peer.command(code, bank=2, crc=CRC_F) == 3


def test_activation_at_reset() -> None:
    for rig in _rig(FakeController(activation=Activation.RESET)):
        write_table_f(rig.peer, 1, activate=True)
        assert rig.peer.word(1162) == 1
        assert (rig.peer.word(1038), rig.peer.word(1043)) == (0, 1)
        assert rig.peer.command(31, bank=1) == 21
        assert rig.peer.command(24) == 1
        assert (rig.peer.word(1038), rig.peer.word(1043)) == (1, 0xFFFF)


def test_scaled_integers() -> None:
    """With `number: int32` and 0.01 µm per count, -0.25 mm is -25 000 in the first two of four registers."""
    for rig in _rig(FakeController(), numbers=ScaledInt32Numbers()):
        rig.controller.position = np.array([1000.0, 150.0, -0.25])
        position = struct.unpack(">i4xi4xi4x", rig.peer.read(1012, 12))
        assert position == (100_000_000, 15_000_000, -25_000)
        numbers = struct.pack(">i4xi4xi4xi4x", 100_000, 200_000, -50_000, 500_000)
        rig.peer.write(2000, struct.pack(">4HI", 1, 12, 0, 0, 0) + numbers + b"\x00\x01")
        assert rig.peer.words(1008, 2) == (1, 1)
        assert rig.controller.orders == [("move", [1.0, 2.0, -0.5], 5.0)]


def test_address_that_is_taken_is_a_clear_error(rig: Rig) -> None:
    with pytest.raises(ConfigurationError, match="cannot listen for modbus on 127"):
        ModbusController(rig.shared, rig.server.address)
