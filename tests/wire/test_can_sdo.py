"""SDO server frames, written by hand from CiA 301 section 7.2.4.3."""

import pytest

from simulators.wire.can.sdo import ObjectEntry, SdoServer

written: list[int] = []


@pytest.fixture
def server() -> SdoServer:
    written.clear()
    return SdoServer(
        {
            (0x1000, 0): ObjectEntry("I", lambda: 0x00020192),
            (0x1008, 0): ObjectEntry("", lambda: "simulated drive"),
            (0x1017, 0): ObjectEntry("H", lambda: 500, written.append),
            (0x1018, 0): ObjectEntry("B", lambda: 4),
            (0x6061, 0): ObjectEntry("b", lambda: -1),
            (0x6064, 0): ObjectEntry("i", lambda: -2),
            (0x6060, 0): ObjectEntry("b", None, written.append),
            (0x607A, 0): ObjectEntry("i", lambda: 0, written.append),
        }
    )


@pytest.mark.parametrize(
    ("request_hex", "answer_hex"),
    [
        ("40 00 10 00 00 00 00 00", "43 00 10 00 92 01 02 00"),  # u32 device type
        ("40 17 10 00 00 00 00 00", "4B 17 10 00 F4 01 00 00"),  # u16 500
        ("40 18 10 00 00 00 00 00", "4F 18 10 00 04 00 00 00"),  # u8
        ("40 61 60 00 00 00 00 00", "4F 61 60 00 FF 00 00 00"),  # i8 -1
        ("40 64 60 00 00 00 00 00", "43 64 60 00 FE FF FF FF"),  # i32 -2
        ("40 34 12 00 00 00 00 00", "80 34 12 00 00 00 02 06"),  # object does not exist
        ("40 18 10 09 00 00 00 00", "80 18 10 09 11 00 09 06"),  # sub-index does not exist
        ("40 60 60 00 00 00 00 00", "80 60 60 00 01 00 01 06"),  # read of a write-only object
        ("2F 61 60 00 01 00 00 00", "80 61 60 00 02 00 01 06"),  # write of a read-only object
        ("2B 7A 60 00 01 00 00 00", "80 7A 60 00 10 00 07 06"),  # two bytes for a u32
        ("21 7A 60 00 08 00 00 00", "80 7A 60 00 10 00 07 06"),  # segmented download of 8 bytes
        ("60 00 00 00 00 00 00 00", "80 00 00 00 01 00 04 05"),  # segment without a transfer
        ("A0 08 10 00 7F 00 00 00", "80 08 10 00 01 00 04 05"),  # block upload
    ],
)
def test_answers(server: SdoServer, request_hex: str, answer_hex: str) -> None:
    assert server.answer(bytes.fromhex(request_hex)) == bytes.fromhex(answer_hex)


def test_expedited_download(server: SdoServer) -> None:
    assert server.answer(bytes.fromhex("23 7A 60 00 90 5F 01 00")) == bytes.fromhex("60 7A 60 00 00 00 00 00")
    assert server.answer(bytes.fromhex("2B 17 10 00 E8 03 00 00")) == bytes.fromhex("60 17 10 00 00 00 00 00")
    assert server.answer(bytes.fromhex("2F 60 60 00 06 00 00 00")) == bytes.fromhex("60 60 60 00 00 00 00 00")
    assert written == [90000, 1000, 6]


def test_segmented_upload(server: SdoServer) -> None:
    assert server.answer(bytes.fromhex("40 08 10 00 00 00 00 00")) == bytes.fromhex("41 08 10 00 0F 00 00 00")
    assert server.answer(bytes.fromhex("60 00 00 00 00 00 00 00")) == b"\x00simulat"
    assert server.answer(bytes.fromhex("70 00 00 00 00 00 00 00")) == b"\x10ed driv"
    assert server.answer(bytes.fromhex("60 00 00 00 00 00 00 00")) == b"\x0de" + bytes(6)


def test_wrong_toggle_aborts_the_transfer(server: SdoServer) -> None:
    server.answer(bytes.fromhex("40 08 10 00 00 00 00 00"))
    assert server.answer(bytes.fromhex("70 00 00 00 00 00 00 00")) == bytes.fromhex("80 08 10 00 00 00 03 05")
    assert server.answer(bytes.fromhex("60 00 00 00 00 00 00 00")) == bytes.fromhex("80 08 10 00 01 00 04 05")


def test_aborts_by_the_client_and_short_frames_are_not_answered(server: SdoServer) -> None:
    assert server.answer(bytes.fromhex("80 00 10 00 00 00 04 05")) is None
    assert server.answer(b"\x40\x00\x10") is None
