"""Controllers of other makes with the documented register map: libmodbus (C, over TCP and serial line) and pyModbusTCP.

Each is an ideal machine with one ball that runs on the wall clock; the driver moves, touches, and stores a table on it.
All waits on the wall clock are the driver's own, bounded ones.
"""

from __future__ import annotations

import os
import pty
import select
import shutil
import socket
import subprocess
import threading
import tty
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from aloud import NOT_HERE
from peers.ideal_registers import BALL, REACH, IdealRegisters, serving

from drivers.clock import RealClock
from drivers.errors import CommandRejected, GuardTripped, LinkTimeout, ProtocolError, StoreError
from drivers.modbus_cnc.device import ModbusCnc
from drivers.modbus_cnc.settings import ModbusCncSettings
from drivers.roles import Miss, MotionState, TableImage, Touch

SOURCE = Path(__file__).parent / "peers" / "ideal_machine.c"
LINE = {"baud": 57600, "parity": "none", "stop_bits": 2}


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Compile the C peer."""
    if not (shutil.which("gcc") and Path("/usr/include/modbus/modbus.h").exists()):
        pytest.skip(f"{NOT_HERE}: the libmodbus peers: gcc or Debian's libmodbus-dev is missing")
    target = tmp_path_factory.mktemp("peer") / "ideal_machine"
    warnings = ["-Wall", "-Wextra", "-Werror", "-I/usr/include/modbus"]
    subprocess.run(["gcc", "-O1", *warnings, "-o", target, SOURCE, "-lmodbus", "-lm"], check=True, timeout=600.0)
    return target


@contextmanager
def running(program: Path, *words: str) -> Iterator[None]:
    """Run the peer until its standard input closes."""
    with subprocess.Popen([program, *words], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            assert process.stdout.readline() == b"ready\n"
            yield
        finally:
            process.stdin.close()
            try:
                process.wait(5.0)
            except subprocess.TimeoutExpired:
                process.kill()
                raise


class Cable:
    """Two connected pseudo-terminals, so that both sides open a device file."""

    def __init__(self) -> None:
        self._ends = [pty.openpty() for _ in range(2)]
        for _, theirs in self._ends:
            tty.setraw(theirs)
        self.ports = [os.ttyname(theirs) for _, theirs in self._ends]
        self._wake, self._waker = os.pipe()
        self._thread = threading.Thread(target=self._carry, daemon=True)
        self._thread.start()

    def close(self) -> None:
        os.write(self._waker, b"!")
        self._thread.join(5.0)
        for end in (*(end for pair in self._ends for end in pair), self._wake, self._waker):
            os.close(end)

    def _carry(self) -> None:
        (first, _), (second, _) = self._ends
        others = {first: second, second: first}
        while True:
            ready, _, _ = select.select([*others, self._wake], [], [])
            if self._wake in ready:
                return
            for end in ready:
                os.write(others[end], os.read(end, 1024))


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as unused:
        return unused.getsockname()[1]


@contextmanager
def opened(**options: Any) -> Iterator[ModbusCnc]:
    quick = {"poll_interval_s": 0.2, "touch_poll_interval_s": 0.1, "timeout_s": 2.0}
    device = ModbusCnc(ModbusCncSettings.model_validate({**quick, **options}), RealClock(), "cnc")
    device.open()
    with closing(device):
        yield device


@contextmanager
def libmodbus_tcp(program: Path, order: str = "high") -> Iterator[ModbusCnc]:
    port = free_port()
    with (
        running(program, "tcp", str(port), order),
        opened(host="127.0.0.1", port=port, word_order=f"{order}-first") as cnc,
    ):
        yield cnc


@contextmanager
def libmodbus_rtu(program: Path, order: str = "high") -> Iterator[ModbusCnc]:
    with closing(Cable()) as cable, running(program, "rtu", cable.ports[1], order):
        serial = {"port": cable.ports[0], **LINE}
        # the peer stops for a second of silence: within it a lost frame is asked for again
        with opened(serial=serial, timeout_s=0.4, retries=3, word_order=f"{order}-first") as cnc:
            yield cnc


@contextmanager
def py_modbus_tcp(registers: IdealRegisters, **options: Any) -> Iterator[ModbusCnc]:
    port = free_port()
    server = serving(registers, port)
    server.start()
    try:
        with opened(host="127.0.0.1", port=port, **options) as cnc:
            yield cnc
    finally:
        server.stop()


@pytest.fixture(params=["libmodbus-tcp", "libmodbus-tcp-low", "libmodbus-rtu", "pymodbustcp",
                         "pymodbustcp-low-word", "pymodbustcp-low-byte", "pymodbustcp-int32-low"])  # fmt: skip
def cnc(request: pytest.FixtureRequest) -> Iterator[ModbusCnc]:
    kind: str = request.param
    low_word, low_byte = "low" in kind and "byte" not in kind, "byte" in kind
    if kind.startswith("libmodbus"):
        peer = libmodbus_rtu if "rtu" in kind else libmodbus_tcp
        with peer(request.getfixturevalue("program"), "low" if low_word else "high") as device:
            yield device
        return
    int32 = "int32" in kind
    registers = IdealRegisters(1e-5 if int32 else None, low_word=low_word, low_byte=low_byte)
    options = {"number_format": "int32" if int32 else "float64"}
    options |= {"word_order": "low-first"} if low_word else {}
    options |= {"byte_order": "low-first"} if low_byte else {}
    with py_modbus_tcp(registers, **options) as device:
        yield device


def table() -> TableImage:
    """Return a table of 45 nodes: three blocks, the last one not full."""
    counts = np.arange(3 * 3 * 5 * 3, dtype=np.int32).reshape(3, 3, 5, 3) * 61 - 4000
    return TableImage((0.0, 10.0, -20.5), (250.0, 240.0, 125.0), 1e-4, counts)


def test_move_touch_and_table(cnc: ModbusCnc) -> None:
    assert cnc.status().state is MotionState.IDLE
    assert cnc.status().missing == ()
    assert cnc.limits().upper_mm == pytest.approx((500.0, 500.0, 500.0))
    assert cnc.temperatures_c() == {"artefact": 20.125}
    before = np.array([250.0, 225.0, 100.0])
    cnc.move_to(np.array([250.0, 100.0, 100.0]), feed_mm_per_s=None, guarded=False)
    cnc.move_to(before, feed_mm_per_s=400.0, guarded=True)
    assert cnc.position() == pytest.approx(before, abs=1e-5)
    miss = cnc.touch_towards(np.array([250.0, 230.0, 100.0]), feed_mm_per_s=50.0)
    assert isinstance(miss, Miss)
    assert miss.position_mm == pytest.approx((250.0, 230.0, 100.0), abs=1e-5)
    touch = cnc.touch_towards(np.add(BALL, (3.0, 0.0, 0.0)), feed_mm_per_s=50.0)
    assert isinstance(touch, Touch)
    assert np.linalg.norm(np.subtract(touch.position_mm, BALL)) == pytest.approx(REACH, abs=2e-5)
    assert cnc.probe_status().deflected
    cnc.move_to(before, feed_mm_per_s=None, guarded=True)
    with pytest.raises(GuardTripped):
        cnc.move_to(np.array(BALL), feed_mm_per_s=100.0, guarded=True)
    assert cnc.status().fault == ""

    assert cnc.read_table(1) is None
    cnc.stage(1, table())
    assert cnc.active_bank() == 0
    cnc.activate(1)
    assert cnc.active_bank() == 1
    read = cnc.read_table(1)
    assert read is not None
    assert np.array_equal(read.counts, table().counts)
    assert read.origin_mm == pytest.approx(table().origin_mm)
    assert read.step_mm == pytest.approx(table().step_mm)
    with pytest.raises(StoreError, match="active"):
        cnc.stage(1, table())
    cnc.activate(0)
    assert cnc.active_bank() == 0


def test_refusals_have_their_reasons(cnc: ModbusCnc) -> None:
    with pytest.raises(CommandRejected, match="outside the travel"):
        cnc.move_to(np.array([0.0, 0.0, 501.0]), feed_mm_per_s=None, guarded=False)
    with pytest.raises(CommandRejected, match="feed not positive or too high"):
        cnc.move_to(np.array([0.0, 0.0, 50.0]), feed_mm_per_s=501.0, guarded=False)
    with pytest.raises(StoreError, match="holds no complete table"):
        cnc.activate(2)


def test_every_peer_passes_the_doctor(cnc: ModbusCnc) -> None:
    findings = cnc.diagnose()
    assert [finding for finding in findings if not finding.ok] == []


@pytest.mark.parametrize(
    ("order", "options", "text"),
    [
        ("low", {}, "illegal position.* would be .* with word_order 'low-first' and byte_order 'high-first'"),
        ("high", {"byte_order": "low-first"}, "illegal position.* with word_order 'high-first' and byte_order 'high-"),
        ("high", {"blocks": {"status": 1001}}, "exception 2, illegal register address"),
        ("high", {"blocks": {"limits": 1500}}, "exception 2, illegal register address"),
    ],
)
def test_wrong_orders_and_addresses_are_told_before_anything_moves(program: Path, order, options, text) -> None:
    """A gap in the map is answered with exception 2."""
    port = free_port()
    with (
        running(program, "tcp", str(port), order),
        pytest.raises(ProtocolError, match=text),
        opened(host="127.0.0.1", port=port, **options),
    ):
        pass


def test_another_unit_is_silent(program: Path) -> None:
    with (
        closing(Cable()) as cable,
        running(program, "rtu", cable.ports[1], "high"),
        pytest.raises(LinkTimeout, match="check unit id"),
        opened(unit=7, timeout_s=0.2, serial={"port": cable.ports[0], **LINE}),
    ):
        pass


def test_a_slow_peer_is_waited_for_and_one_too_slow_is_not() -> None:
    registers = IdealRegisters()
    with py_modbus_tcp(registers, timeout_s=2.0, retries=0) as cnc:
        registers.answer_after_s = 0.1
        cnc.move_to(np.array([150.0, 100.0, 100.0]), feed_mm_per_s=None, guarded=False)
        assert cnc.position()[0] == pytest.approx(150.0)
        registers.answer_after_s = 3.0
        with pytest.raises(LinkTimeout, match="no answer within 2 s"):
            cnc.move_to(np.array([140.0, 100.0, 100.0]), feed_mm_per_s=None, guarded=False)
        registers.answer_after_s = 0.0
