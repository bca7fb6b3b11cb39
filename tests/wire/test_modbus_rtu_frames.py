"""Modbus RTU byte by byte.

Golden frames: MODBUS Application Protocol V1.1b3, 6.3, 6.12, 6.17 and 7; Modicon's guide PI-MBUS-300 for those of unit
17; MODBUS over Serial Line V1.02 for CRC and times.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest
from rtu_slave import RtuSlave, crc, framed, scripted
from waiting import PATIENCE_S, SILENCE_S

from drivers.clock import InterruptibleClock, VirtualClock
from drivers.errors import ConfigurationError, LinkLost, LinkTimeout, ProtocolError
from drivers.links.modbus import ModbusLink
from drivers.links.modbus_rtu import RtuEndpoint, RtuTransport
from drivers.links.modbus_serial_line import SerialLine, crc16
from drivers.links.modbus_transport import DamagedFrame

READ_17 = bytes.fromhex("11 03 006B 0003 7687")
ANSWER_17 = bytes.fromhex("11 03 06 AE41 5652 4340 49AD")
WRITE_17 = bytes.fromhex("11 10 0001 0002 04 000A 0102 C6F0")
WRITTEN_17 = bytes.fromhex("11 10 0001 0002 1298")
VALUE_17 = bytes.fromhex("AE41 5652 4340")


@contextmanager
def linked(
    slave: RtuSlave, *, unit: int = 17, retries: int = 0, timeout_s: float = PATIENCE_S, clock=None, **line: object
) -> Iterator[ModbusLink]:
    settings = SerialLine.model_validate({"port": slave.port, "parity": "none", "stop_bits": 2, **line})
    endpoint = RtuEndpoint(settings, unit)
    where = {"device": "cnc", "link": str(endpoint)}
    transport = RtuTransport(endpoint, clock or VirtualClock(), timeout_s=timeout_s, where=where)
    link = ModbusLink(transport, writable=[range(20)], where=where, retries=retries)
    with closing(slave):
        link.open()
        with closing(link):
            yield link


def test_the_crc_is_that_of_the_standard() -> None:
    assert crc16(bytes.fromhex("02 07")) == 0x1241
    assert bytes.fromhex("02 07") + crc(bytes.fromhex("02 07")) == bytes.fromhex("02 07 41 12")


def test_golden_read() -> None:
    slave = scripted(ANSWER_17)
    with linked(slave) as link:
        assert link.read(0x6B, 3) == VALUE_17
        assert slave.requests == [READ_17]
        assert link.latency.count == 1


def test_the_frame_of_the_register_map_is_the_drivers() -> None:
    page = Path(__file__).parents[2] / "docs" / "reference" / "modbus-register-map.md"
    golden = bytes.fromhex(page.read_text(encoding="utf-8").split("**H**")[1].split("```")[1])
    assert golden[:-2] + crc(golden[:-2]) == golden
    slave = scripted(framed("01 03 8C" + "00" * 140))
    with linked(slave, unit=1) as link:
        assert link.read(1000, 70) == bytes(140)
    assert slave.requests == [golden]


def test_golden_write() -> None:
    slave = scripted(WRITTEN_17)
    with linked(slave) as link:
        link.write(1, bytes.fromhex("000A 0102"), idempotent=True)
        assert slave.requests == [WRITE_17]


def test_golden_write_and_read() -> None:
    """Example of V1.1b3, 6.17: six registers from 3 are read, three from 14 written."""
    slave = scripted(framed("11 17 0C 00FE 0ACD 0001 0003 000D 00FF"))
    with linked(slave) as link:
        read = link.exchange(14, bytes.fromhex("00FF 00FF 00FF"), 3, 6, idempotent=True)
        assert slave.requests == [framed("11 17 0003 0006 000E 0003 06 00FF 00FF 00FF")]
    assert read == bytes.fromhex("00FE 0ACD 0001 0003 000D 00FF")


@pytest.mark.parametrize(
    ("code", "text"),
    [
        (1, "exception 1, illegal function"),
        (2, "exception 2, illegal register address"),
        (3, "exception 3, illegal value or count"),
        (4, "exception 4, device failure"),
        (5, "exception 5, acknowledge"),
        (7, "exception 7, negative acknowledge"),
        (8, "exception 8, memory parity error"),
        (10, "exception 10, gateway path unavailable"),
        (11, "exception 11, gateway target does not answer"),
        (77, "exception 77, unknown"),
    ],
)
def test_each_exception_is_a_typed_error(code: int, text: str) -> None:
    slave = scripted(framed(f"11 83 {code:02X}"))
    with linked(slave, retries=2) as link:
        with pytest.raises(ProtocolError, match=rf"{text}.*register 107, device cnc, link modbus-rtu"):
            link.read(0x6B, 3)
        assert len(slave.requests) == 1  # understood and refused: asking again would not help


def test_busy_is_asked_again() -> None:
    slave = scripted(framed("11 83 06"), ANSWER_17)
    with linked(slave, retries=1) as link:
        assert link.read(0x6B, 3) == VALUE_17
        assert link.repeat_count == 1
    slave = scripted(framed("11 83 06"))
    with linked(slave) as link, pytest.raises(LinkTimeout, match="busy"):
        link.read(0x6B, 3)


def test_a_server_without_function_23_gets_16_and_3() -> None:
    slave = scripted(framed("11 97 01"), framed("11 10 0002 0001"), framed("11 03 02 002A"))
    with linked(slave) as link:
        assert link.exchange(2, b"\x00\x07", 5, 1, idempotent=False) == b"\x00\x2a"
    assert [request[1] for request in slave.requests] == [23, 16, 3]


DAMAGES: dict[str, Callable[[bytes], bytes]] = {
    "one bit": lambda frame: frame[:4] + bytes((frame[4] ^ 0x10,)) + frame[5:],
    "CRC bytes exchanged": lambda frame: frame[:-2] + frame[:-3:-1],
    "cut short": lambda frame: frame[:-1],
    "one byte": lambda frame: frame[:1],
    "glitch before": lambda frame: b"\xff" + frame,
    "byte missing": lambda frame: frame[:3] + frame[4:],
    "byte count": lambda frame: frame[:2] + b"\xff" + frame[3:],
    "unit": lambda frame: b"\x13" + frame[1:],
    "noise": lambda _frame: bytes(range(200, 240)),
}


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES.keys())
def test_a_damaged_answer_is_told_as_such_and_asked_again(damage: Callable[[bytes], bytes]) -> None:
    slave = scripted(damage(ANSWER_17))
    with (
        linked(slave, timeout_s=SILENCE_S) as link,
        pytest.raises(DamagedFrame, match=r"(garbled|cut short).*register 107, device cnc"),
    ):
        link.read(0x6B, 3)
    slave = scripted(damage(ANSWER_17), ANSWER_17)
    with linked(slave, timeout_s=SILENCE_S, retries=1) as link:
        assert link.read(0x6B, 3) == VALUE_17
        assert (len(slave.requests), link.repeat_count) == (2, 1)


def test_what_is_not_idempotent_is_sent_once() -> None:
    slave = scripted(ANSWER_17[:-1])
    with linked(slave, timeout_s=SILENCE_S, retries=3) as link, pytest.raises(DamagedFrame):
        link.exchange(2, b"\x00\x07", 5, 1, idempotent=False)
    assert len(slave.requests) == 1


@pytest.mark.parametrize(
    ("answer", "text"),
    [
        (framed("12 03 06 AE41 5652 4340"), "unit 18 answered instead of unit 17"),
        (framed("11 10 0001 0002"), "function 3 was answered with function 16"),
        (framed("11 03 04 AE41 5652"), "requested 3 registers, but the answer holds 4 bytes"),
        (framed("11 03 08 AE41 5652 4340 0000"), "requested 3 registers, but the answer holds 8 bytes"),
        (READ_17, "the line echoes the request"),
        (READ_17 + ANSWER_17, "the line echoes the request"),
    ],
)
def test_sound_frames_that_are_no_answer(answer: bytes, text: str) -> None:
    slave = scripted(answer)
    with linked(slave, retries=2) as link, pytest.raises(ProtocolError, match=text) as caught:
        link.read(0x6B, 3)
    assert not isinstance(caught.value, DamagedFrame)
    assert len(slave.requests) == 1


def test_the_echo_of_a_write_is_recognised() -> None:
    with linked(scripted(WRITE_17 + WRITTEN_17)) as link, pytest.raises(ProtocolError, match=r"serial.echo = true"):
        link.write(1, bytes.fromhex("000A 0102"), idempotent=True)


def test_an_answer_that_comes_late_or_twice_is_not_the_next_ones() -> None:
    other = framed("11 03 06 0001 0002 0003")
    slave = scripted(None, ANSWER_17 + ANSWER_17, other)
    with linked(slave, timeout_s=SILENCE_S) as link:
        with pytest.raises(LinkTimeout, match="no answer within"):
            link.read(0x6B, 3)
        slave.push(framed("11 03 06 DEAD DEAD DEAD"))  # what should have come before
        assert link.read(0x6B, 3) == VALUE_17
        assert link.read(0x6B, 3) == bytes.fromhex("0001 0002 0003")  # the copy was thrown away
        assert isinstance(link.transport, RtuTransport)
        assert link.transport.stray_bytes == 2 * len(ANSWER_17)


def test_echo_is_taken_where_the_adapter_has_one() -> None:
    with linked(scripted(READ_17 + ANSWER_17), echo=True) as link:
        assert link.read(0x6B, 3) == VALUE_17
    with (
        linked(scripted(ANSWER_17), echo=True) as link,
        pytest.raises(DamagedFrame, match=r"was echoed as .*echo = false"),
    ):
        link.read(0x6B, 3)
    with (
        linked(scripted(), timeout_s=SILENCE_S, echo=True) as link,
        pytest.raises(LinkTimeout, match="neither echo nor answer"),
    ):
        link.read(0x6B, 3)


@pytest.mark.parametrize(
    ("baud", "parity", "stop_bits", "character_s", "gap_s"),
    [
        (19200, "even", 1, 11 / 19200, 3.5 * 11 / 19200),
        (9600, "none", 2, 11 / 9600, 3.5 * 11 / 9600),
        (1200, "none", 1, 10 / 1200, 3.5 * 10 / 1200),
        (38400, "odd", 1, 11 / 38400, 0.00175),
        (115200, "odd", 2, 12 / 115200, 0.00175),
    ],
)
def test_the_line_takes_its_time_on_the_machines_clock(baud, parity, stop_bits, character_s, gap_s) -> None:
    clock = VirtualClock()
    clock.advance_to(100.0)
    with linked(scripted(ANSWER_17), clock=clock, baud=baud, parity=parity, stop_bits=stop_bits) as link:
        link.read(0x6B, 3)
    assert clock.now() - 100.0 == pytest.approx((8 + 11) * character_s + 2 * gap_s)


def test_a_lost_answer_costs_its_timeout() -> None:
    clock = VirtualClock()
    with linked(scripted(), timeout_s=0.1, clock=clock, baud=115200) as link, pytest.raises(LinkTimeout):
        link.read(0x6B, 3)
    assert 0.1 < clock.now() < 0.11


def test_the_silence_between_frames_can_be_set() -> None:
    clock = VirtualClock()
    with linked(scripted(ANSWER_17), clock=clock, frame_gap_s=0.05) as link:
        link.read(0x6B, 3)
    assert clock.now() == pytest.approx(19 * 11 / 19200 + 0.1)


def test_no_hold_and_no_abort_between_a_request_and_its_answer() -> None:
    def check() -> None:
        raise AssertionError("interrupted within a transaction")

    with linked(scripted(ANSWER_17), clock=InterruptibleClock(VirtualClock(), check)) as link:
        assert link.read(0x6B, 3) == VALUE_17


@pytest.mark.parametrize(("register", "count"), [(20, 1), (19, 2), (65535, 1)])
def test_a_write_outside_the_allow_list_never_reaches_the_wire(register: int, count: int) -> None:
    slave = scripted()
    with linked(slave) as link:
        with pytest.raises(ConfigurationError, match="write outside"):
            link.write(register, bytes(2 * count), idempotent=True)
        with pytest.raises(ConfigurationError, match="write outside"):
            link.exchange(register, bytes(2 * count), 0, 1, idempotent=True)
    assert slave.requests == []


def test_a_line_with_parity_is_opened_again_and_again() -> None:
    slave = scripted(ANSWER_17, ANSWER_17, ANSWER_17)
    with linked(slave, parity="even", stop_bits=1) as link:
        for _ in range(3):
            assert link.read(0x6B, 3) == VALUE_17
            link.close()
            link.open()


def test_a_file_that_is_no_serial_port(tmp_path: Path) -> None:
    (tmp_path / "port").touch()
    with pytest.raises(LinkLost, match="cannot be opened"), linked(scripted(), port=str(tmp_path / "port")):
        pass


def test_a_port_that_is_not_there_or_taken_or_gone() -> None:
    slave = scripted()
    with linked(slave) as link:
        with pytest.raises(LinkLost, match=r"cannot be opened.*no other program has it"), linked(slave):
            pass
        slave.close()
        with pytest.raises(LinkLost, match="serial port lost"):
            link.read(0x6B, 3)
        assert not link.connected
        with pytest.raises(LinkLost, match="serial port lost"):
            link.read(0x6B, 3)
    with pytest.raises(LinkLost, match="cannot be opened"), linked(slave, port="/dev/volcal-absent"):
        pass
