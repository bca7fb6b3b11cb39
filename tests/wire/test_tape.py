"""Punch and read over a real pseudo-terminal in virtual time; characters and blocks from the maker's manuals."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.clock import VirtualClock
from drivers.errors import DeadlineExpired, LinkLost, LinkTimeout, ProtocolError, ReadBackMismatch
from drivers.serial_cnc.tape.blocks import TapeError, differences, parse_tape
from drivers.serial_cnc.tape.transfer import (
    DeviceControl,
    ParityFault,
    PunchRead,
    TapeSettings,
    decode,
    encode,
    encode_control,
)
from simulators.wire.tape.controller import Mode, TapeCnc

MANUAL = "%\nN00000P00001100\nN00002P00000000\nN09162P00000000\nN09163P00000000\n%\n"
"""Example of B-63330EN/03, 3 (15i): beginning and end of a record."""
PARAMETERS = {number: f"P{number * 7}" for number in range(3620, 3660)} | {
    1005: "A1P10000001A2P10000001A3P10000001",
    5603: "S1P00001000S2P00001000S3P00000000",
}


LONG = parse_tape("%\n" + "".join(f"N{number}P{number}\n" for number in range(3000, 3100)) + "%")


@dataclass
class Line:
    cnc: TapeCnc
    clock: VirtualClock
    punch_read: PunchRead
    asked: list[str] = field(default_factory=list)
    presses: bool = True


@pytest.fixture
def line() -> Iterator[Line]:
    yield from made(TapeCnc(PARAMETERS))


def made(cnc: TapeCnc) -> Iterator[Line]:
    clock = VirtualClock()
    clock.subscribe(cnc.on_advance)
    settings = TapeSettings(port=cnc.line.device_path, operator_timeout_s=60.0, max_pause_s=20.0)
    built = Line(cnc, clock, PunchRead(settings, clock, lambda text: press(built, text), device="cnc"))
    with built.punch_read:
        yield built
    cnc.line.close()


def press(line: Line, text: str) -> None:
    line.asked.append(text)
    if line.presses:
        key = line.cnc.press_punch if "PUNCH" in text else line.cnc.press_read
        at_s = line.clock.now() + 3.0
        line.clock.subscribe(once(at_s, key))


def once(at_s: float, action: Callable[[], None]) -> Callable[[float], None]:
    done: list[bool] = []

    def check(now_s: float) -> None:
        if now_s >= at_s and not done:
            done.append(True)
            action()

    return check


class TestCharacters:
    @pytest.mark.parametrize(
        ("text", "holes"),
        [("0", 0x30), ("1", 0xB1), ("2", 0xB2), ("3", 0x33), ("N", 0x4E), ("P", 0x50), ("%", 0xA5), ("\n", 0x0A),
         ("A", 0x41), ("O", 0xCF), ("-", 0x2D), (".", 0x2E), ("X", 0xD8), ("Q", 0xD1)],
    )  # fmt: skip
    def test_iso_code_with_its_parity_hole(self, text: str, holes: int) -> None:
        assert encode(text) == bytes((holes,))

    def test_controls(self) -> None:
        assert [encode_control(c).hex() for c in DeviceControl] == ["11", "12", "93", "14"]

    def test_blank_tape_and_returns_mean_nothing(self) -> None:
        assert decode(b"\x00\x8d\xff\xa0\xa5") == ["%"]

    @given(st.text("%NPQASMI0123456789.+-\n", max_size=60))
    def test_round_trip(self, text: str) -> None:
        assert "".join(str(character) for character in decode(encode(text))) == text

    @given(st.text("%NPQA0123456789", min_size=1, max_size=20), st.integers(0, 7), st.data())
    def test_one_wrong_hole_is_seen(self, text: str, bit: int, data: st.DataObject) -> None:
        punched = bytearray(encode(text))
        punched[data.draw(st.integers(0, len(punched) - 1))] ^= 1 << bit
        assert any(isinstance(character, ParityFault) for character in decode(bytes(punched)))


class TestBlocks:
    def test_example_of_the_manual(self) -> None:
        tape = parse_tape(MANUAL)
        assert tape.text() == MANUAL
        assert not differences(tape, tape)

    def test_label_before_and_trailer_behind_are_left_out(self) -> None:
        assert parse_tape("ALL-PARA" + MANUAL + "\x00 trailer") == parse_tape(MANUAL)

    def test_axis_and_spindle_values_are_compared_one_by_one(self) -> None:
        wanted = parse_tape("%\nN01005Q1A1P10000001A2P10000001\nN5603S1P1\n%")
        found = parse_tape("%\nN1005A1P10000001A2P00000001\nN5603S1P1\n%")
        assert [str(difference) for difference in differences(wanted, found)] == [
            "N1005A2: wrote P10000001, reads P00000001"
        ]

    def test_numbers_by_value_bits_digit_by_digit_units_by_letter(self) -> None:
        def same(one: str, other: str) -> bool:
            return not differences(parse_tape(f"%\nN1{one}\n%"), parse_tape(f"%\nN1{other}\n%"))

        assert same("P30.0", "P30")
        assert same("P+5", "P005")
        assert not same("P00000001", "P1")
        assert not same("M1.0", "I1.0")
        assert not same("P1", "P-1")

    def test_missing_value_is_a_difference(self) -> None:
        [difference] = differences(parse_tape("%\nN1P1\nN2P2\n%"), parse_tape("%\nN1P1\n%"))
        assert str(difference) == "N2: wrote P2, not there"

    @pytest.mark.parametrize("text", ["", "N1P1\n", "%\nN1P1\n", "%\nN1P\n%", "%\n?\n%", "%\nN1 P1\n%", "%\nn1p1\n%"])
    def test_what_is_no_tape(self, text: str) -> None:
        with pytest.raises(TapeError):
            parse_tape(text)


class TestPunch:
    def test_what_the_controller_punches_is_what_it_holds(self, line: Line) -> None:
        tape = line.punch_read.receive()
        assert line.asked == ["press PUNCH at the controller"]
        assert len(tape.blocks) == len(PARAMETERS)
        assert tape.text().count("N01005Q1A1P10000001A2P10000001A3P10000001\n") == 1
        assert line.clock.now() > len(tape.text()) * 11 / 4800

    def test_nobody_presses(self, line: Line) -> None:
        line.presses = False
        with pytest.raises(DeadlineExpired, match="PUNCH was not pressed within 60 s"):
            line.punch_read.receive()

    def test_readable_leader_is_left_out(self, line: Line) -> None:
        line.presses = False
        line.cnc.press_punch("PARAMETER BACKUP N1P2\n")
        assert len(line.punch_read.receive().blocks) == len(PARAMETERS)

    def test_tape_that_breaks_off(self, line: Line) -> None:
        line.clock.subscribe(once(4.0, line.cnc.press_reset))
        with pytest.raises(LinkTimeout, match=r"breaks off after \d+ blocks"):
            line.punch_read.receive()

    def test_wrong_hole(self, line: Line) -> None:
        at: list[int] = []

        def bad(data: bytes) -> bytes:
            at.append(1)
            return bytes((data[0] ^ 0x04,)) if len(at) == 200 else data

        line.cnc.line.distort = bad
        with pytest.raises(ProtocolError, match="parity fault in block"):
            line.punch_read.receive()

    def test_lost_second_mark(self, line: Line) -> None:
        seen: list[bytes] = []

        def without(data: bytes) -> bytes:
            seen.append(data)
            return b"" if data == b"\xa5" and seen.count(b"\xa5") == 2 else data

        line.cnc.line.distort = without
        with pytest.raises(ProtocolError, match="without a second %"):
            line.punch_read.receive()

    def test_line_that_goes(self, line: Line) -> None:
        line.clock.subscribe(once(4.0, line.cnc.line.close))
        with pytest.raises(LinkLost, match="gone"):
            line.punch_read.receive()


class TestRead:
    def test_both_directions_and_the_comparison(self, line: Line) -> None:
        backup = line.punch_read.receive()
        line.cnc.parameters = dict.fromkeys(PARAMETERS, "P1")
        line.punch_read.write(backup)
        assert line.cnc.parameters == PARAMETERS
        assert [text.split()[1] for text in line.asked] == ["PUNCH", "READ", "PUNCH"]

    def test_controller_that_stops_us_is_obeyed_within_ten_characters(self, line: Line) -> None:
        line.punch_read.send(LONG)
        line.clock.sleep(1.0)
        assert line.cnc.mode is Mode.READY
        assert line.cnc.parameters[3099] == "P3099"
        assert 0 <= line.cnc.overrun <= 10

    def test_slow_controller_stops_us_often(self) -> None:
        for line in made(TapeCnc({}, baud=600)):
            line.punch_read.send(LONG)
            line.clock.sleep(20.0)
            assert line.cnc.parameters[3099] == "P3099"
            assert 0 < line.cnc.overrun <= 10

    def test_xoff_that_is_never_lifted(self) -> None:
        for line in made(TapeCnc({}, baud=600)):
            line.cnc.stays_stopped = True
            with pytest.raises(LinkTimeout, match="stopped the transfer") as caught:
                line.punch_read.send(LONG)
            assert "of 102 blocks; read its backup back in" in caught.value.__notes__[0]

    def test_write_protection_stops_us_too(self) -> None:
        for line in made(TapeCnc({}, writable=False)):
            with pytest.raises(LinkTimeout, match="stopped the transfer"):
                line.punch_read.send(parse_tape(MANUAL))
            assert line.cnc.alarm == "parameters are write-protected"

    def test_nobody_presses(self, line: Line) -> None:
        line.presses = False
        with pytest.raises(DeadlineExpired, match="READ was not pressed"):
            line.punch_read.send(parse_tape(MANUAL))

    def test_value_that_the_controller_keeps_otherwise(self, line: Line) -> None:
        line.cnc.misstored = {2: "P00000001"}
        with pytest.raises(ReadBackMismatch, match="N2: wrote P00000000, reads P00000001"):
            line.punch_read.write(parse_tape(MANUAL))
