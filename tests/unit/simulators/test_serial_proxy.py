"""Proxy of a serial line that the campaign of faults puts between a driver and a simulated device."""

from __future__ import annotations

import os
import termios
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest

from campaigns.faults.disturbances import lost, repeated
from campaigns.faults.link_proxy import SerialProxy, ending_with
from simulators.wire.pty_port import PseudoTerminal

BAUD = 19200


@pytest.fixture
def device() -> Iterator[PseudoTerminal]:
    """Device that answers each piece of data with itself."""
    terminal = PseudoTerminal("device", lambda data: terminal.send(data))  # noqa: PLW0108  it is assigned only now
    terminal.start()
    yield terminal
    terminal.close()


@pytest.fixture
def proxy(device: PseudoTerminal, tmp_path: Path) -> Iterator[SerialProxy]:
    made = SerialProxy(device.port, tmp_path / "line", ending_with(b"\r"), BAUD)
    yield made
    made.close()


def opened(proxy: SerialProxy) -> int:
    line = os.open(proxy.link, os.O_RDWR | os.O_NOCTTY)
    tty.setraw(line)
    return line


def answer(line: int, count: int) -> bytes:
    data = b""
    while len(data) < count:
        data += os.read(line, 100)
    return data


def hung_up(line: int) -> bool:
    """Return True once the other end of the line is closed."""
    try:
        return os.read(line, 1) == b""
    except OSError:
        return True


def test_it_forwards_both_ways_and_the_device_sees_its_baud_rate(proxy: SerialProxy, device: PseudoTerminal) -> None:
    line = opened(proxy)
    os.write(line, b"abc\r")
    assert answer(line, 4) == b"abc\r"
    seen = os.open(device.port, os.O_RDWR | os.O_NOCTTY)
    assert termios.tcgetattr(seen)[5] == termios.B19200
    os.close(seen)
    os.close(line)


def test_frames_are_lost_and_repeated(proxy: SerialProxy) -> None:
    line = opened(proxy)
    proxy.to_server = lost(1)
    os.write(line, b"lost\rkept\r")
    assert answer(line, 5) == b"kept\r"
    proxy.to_client = repeated(1)
    os.write(line, b"twice\r")
    assert answer(line, 12) == b"twice\rtwice\r"
    os.close(line)


def test_an_unplugged_adapter_is_gone_until_it_is_plugged_in_again(proxy: SerialProxy) -> None:
    line = opened(proxy)
    proxy.refusing = True
    proxy.cut()
    assert hung_up(line)
    os.close(line)
    with pytest.raises(FileNotFoundError):
        opened(proxy)
    proxy.repair()
    line = opened(proxy)
    os.write(line, b"again\r")
    assert answer(line, 6) == b"again\r"
    os.close(line)
