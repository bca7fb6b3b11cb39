"""Serial CAN adapter: LAWICEL's commands byte by byte, bursts in both directions, and failing adapters."""

from __future__ import annotations

import contextlib
import os
import pty
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import can
import canopen
import pytest
import serial
from can_listening import listening
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import ConfigurationError, LinkLost
from drivers.links import can_adapters
from drivers.links.can_adapters import CanAddress, SlcanBus, open_bus
from drivers.links.can_bus import CanNetworks
from simulators.wire.can.channel import open_channel
from simulators.wire.can.slcan_peer import SlcanPeerBus, format_frame, parse_frame

READY = {"bitrate": 500_000, "sleep_after_open": 0.0}
BURST = 5000


@pytest.fixture
def peer() -> Iterator[SlcanPeerBus]:
    with SlcanPeerBus() as bus:
        yield bus


class Terminal:
    """Host that types commands, with only Python's serial line."""

    def __init__(self, port: str) -> None:
        self._line = serial.Serial(port, timeout=600.0)

    def ask(self, command: str, answer: bytes) -> None:
        self._line.write(command.encode("ascii") + b"\r")
        assert self._line.read(len(answer)) == answer, command

    def hear(self, expected: bytes) -> None:
        assert self._line.read(len(expected)) == expected

    def close(self) -> None:
        self._line.close()


def test_dialogue_of_the_manual(peer: SlcanPeerBus) -> None:
    host = Terminal(peer.port)
    host.ask("O", b"\a")  # no bit rate yet
    host.ask("F", b"\a")  # only while it is open
    host.ask("S6", b"\r")
    host.ask("S9", b"\a")
    host.ask("O", b"\r")
    host.ask("S4", b"\a")  # not while it is open
    host.ask("t10021133", b"z\r")  # the manual's own: identifier 0x100, two bytes 0x11 0x33
    host.ask("T0000010021133", b"Z\r")
    host.ask("T000010021133", b"\a")  # an identifier of seven digits
    host.ask("r1000", b"z\r")
    host.ask("t1002113", b"\a")  # half a byte is missing
    host.ask("t1009", b"\a")
    host.ask("x", b"\a")
    host.ask("F", b"F00\r")
    host.ask("V", b"V1013\r")
    peer.send(can.Message(arbitration_id=0x705, data=b"\x05", is_extended_id=False))
    host.hear(b"t705105\r")
    host.ask("C", b"\r")
    host.ask("C", b"\a")
    host.ask("t10021133", b"\a")
    host.close()
    frames = [peer.recv(1.0) for _ in range(3)]
    assert [(f.arbitration_id, f.is_extended_id, f.is_remote_frame, bytes(f.data)) for f in frames if f] == [
        (0x100, False, False, b"\x11\x33"),
        (0x100, True, False, b"\x11\x33"),
        (0x100, False, True, b""),
    ]


def test_time_stamps_are_four_digits_below_a_minute(peer: SlcanPeerBus) -> None:
    host = Terminal(peer.port)
    for command in ("Z1", "S6", "O"):
        host.ask(command, b"\r")
    peer.send(can.Message(arbitration_id=0x85, data=b"", is_extended_id=False))
    line = host._line.read_until(b"\r")
    assert line[:5] == b"t0850"
    assert int(line[5:9], 16) < 60_000
    assert len(line) == 10
    host.close()


def test_listening_only_sends_nothing(peer: SlcanPeerBus) -> None:
    host = Terminal(peer.port)
    host.ask("S6", b"\r")
    host.ask("L", b"\r")
    host.ask("t1000", b"\a")
    host.close()


@given(identifier=st.integers(0, 0x1FFFFFFF), data=st.binary(max_size=8), extended=st.booleans(), remote=st.booleans())
def test_a_frame_survives_its_text(identifier: int, data: bytes, extended: bool, remote: bool) -> None:
    there = can.Message(
        arbitration_id=identifier if extended else identifier & 0x7FF,
        data=None if remote else data,
        dlc=len(data),
        is_extended_id=extended,
        is_remote_frame=remote,
    )
    assert parse_frame(format_frame(there).decode("ascii")).equals(there, timestamp_delta=None, check_direction=False)


@given(st.text(st.sampled_from("tTrR0123456789ABCDEFxyz"), max_size=30))
def test_any_text_is_a_frame_or_refused(text: str) -> None:
    if text[:1] in tuple("tTrR"):
        try:
            frame = parse_frame(text)
        except ValueError:
            return
        assert format_frame(frame).decode("ascii") == text


def until(reached: Callable[[], bool]) -> None:
    ends = time.monotonic() + 600.0
    while not reached():
        assert time.monotonic() < ends
        time.sleep(0.01)


def numbers(messages: list[can.Message]) -> list[int]:
    return [int.from_bytes(message.data, "little") for message in messages]


def numbered(number: int) -> can.Message:
    return can.Message(arbitration_id=0x181, data=number.to_bytes(8, "little"), is_extended_id=False)


def test_a_burst_to_the_host_arrives_whole_and_in_order(peer: SlcanPeerBus) -> None:
    """110 kB at once is far more than the line holds; the rest must wait without loss."""
    with SlcanBus(peer.port, **READY) as host:
        for number in range(BURST):
            peer.send(numbered(number))
        with listening(peer), listening(host) as heard:
            until(lambda: len(heard) == BURST)
            assert numbers(heard) == list(range(BURST))
            assert host.status_flags(5.0) == 0


def test_a_queue_that_overflows_loses_frames_and_says_so(peer: SlcanPeerBus, monkeypatch) -> None:
    monkeypatch.setattr("simulators.wire.can.slcan_peer.QUEUED_FRAMES", 100)
    with SlcanBus(peer.port, **READY) as host:
        for number in range(BURST):
            peer.send(numbered(number))
        with listening(peer), listening(host) as heard:
            assert host.status_flags(5.0) == 0x01
            assert numbers(heard) == list(range(len(heard)))
            assert 100 < len(heard) < BURST
            assert host.status_flags(5.0) == 0, "told once"


def test_a_burst_from_the_host_arrives_whole_and_in_order(peer: SlcanPeerBus) -> None:
    with SlcanBus(peer.port, **READY) as host, listening(host), listening(peer) as heard:
        for number in range(BURST):
            host.send(numbered(number))
        until(lambda: len(heard) == BURST)
        assert numbers(heard) == list(range(BURST))
        assert host.refusals == 0


def test_the_opening_is_no_refusal_and_a_refused_frame_is(peer: SlcanPeerBus) -> None:
    with SlcanBus(peer.port, **READY) as host, listening(host):
        assert host.refusals == 0
        peer.go_off_bus()
        host.send(numbered(1))
        assert host.status_flags(5.0) == 0xA4
        assert host.refusals == 1


def test_an_adapter_has_one_owner(peer: SlcanPeerBus) -> None:
    address = CanAddress.of("slcan", peer.port, READY)
    first = open_bus(address)
    with pytest.raises(LinkLost, match=r"cannot open the CAN bus.*no other program has it open"):
        open_bus(address)
    first.shutdown()
    open_bus(address).shutdown()


def test_two_devices_with_other_options_do_not_share_a_port(peer: SlcanPeerBus) -> None:
    networks = CanNetworks()
    link = networks.acquire(CanAddress.of("slcan", peer.port, READY))
    with pytest.raises(ConfigurationError, match="two devices have different options"):
        networks.acquire(CanAddress.of("slcan", peer.port, {**READY, "bitrate": 125_000}))
    link.close()


@contextmanager
def dead_adapter() -> Iterator[str]:
    """Port that opens but has no adapter behind it: nothing is read or answered."""
    ours, theirs = pty.openpty()
    yield os.ttyname(theirs)
    os.close(ours)
    os.close(theirs)


def test_dead_adapter_does_not_hold_who_sends(monkeypatch) -> None:
    monkeypatch.setattr(can_adapters, "SEND_WITHIN_S", 0.1)
    monkeypatch.setattr(can_adapters, "FLAGS_WITHIN_S", 0.05)
    with dead_adapter() as port:
        host = SlcanBus(port, **READY)
        with pytest.raises(can.CanOperationError):
            for number in range(10_000):
                host.send(numbered(number))
        with contextlib.suppress(can.CanOperationError):  # one byte more may still fit
            host.shutdown()
        with pytest.raises(can.CanOperationError, match="is gone"):
            host.recv(0.1)


def test_port_that_is_none_says_so(tmp_path: Path) -> None:
    with pytest.raises(LinkLost, match=rf"slcan:{tmp_path}/ttyUSB7.*plugged in"):
        open_bus(CanAddress.of("slcan", str(tmp_path / "ttyUSB7"), READY))
    with SlcanPeerBus() as peer, pytest.raises(ConfigurationError, match="bitrate 123 is not one of 10000"):
        open_bus(CanAddress.of("slcan", peer.port, {**READY, "bitrate": 123}))


def test_adapter_that_is_pulled_out_is_a_lost_link() -> None:
    peer = SlcanPeerBus()
    link = CanNetworks().acquire(CanAddress.of("slcan", peer.port, READY))
    assert link._shared is not None
    receiver = link._shared.receiver
    peer.shutdown()
    receiver.join(5.0)
    with pytest.raises(LinkLost, match="serial port of the adapter is gone"):
        link.check()
    link.close()


def test_link_asks_its_adapter(peer: SlcanPeerBus) -> None:
    link = CanNetworks().acquire(CanAddress.of("slcan", peer.port, READY))
    assert link.adapter_status_text() == "the adapter reports no error"
    peer.go_off_bus()
    link.add_node(5, canopen.ObjectDictionary()).network.send_message(0x605, b"\x40" + bytes(7))
    assert link.adapter_status_text() == (
        "the adapter reports error warning, error passive, bus error; it has refused 1 commands"
    )
    link.close()


def test_place_of_the_terminal(tmp_path: Path) -> None:
    place = tmp_path / "can-adapter"
    channel = open_channel(f"slcan:{place}")
    assert channel.agent_settings == {"interface": "slcan", "channel": str(place), "options": READY}
    assert place.is_symlink()
    channel.bus.shutdown()
    assert not place.exists()
    place.write_text("somebody's file")
    with pytest.raises(ConfigurationError, match="does not exist yet"):
        open_channel(f"slcan:{place}")
    assert place.read_text() == "somebody's file"
