"""A stop reaches the machine on every link, whatever has happened to the connection, and within a bounded time."""

from __future__ import annotations

import json
import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from pathlib import Path

import can
import numpy as np
import pytest
from canopen_rig import rig as canopen_rig
from modbus_plc import FakePlc
from modbus_rig import opened
from serial import Serial
from serial_rig import Rig
from serial_rig import rig as serial_rig

from agent.errors import Aborted
from drivers.clock import InterruptibleClock, VirtualClock, wall_seconds
from drivers.errors import DeviceError, LinkLost, LinkTimeout
from drivers.links.serial_port import SerialAddress, SerialPort
from drivers.linuxcnc.bridge_link import BridgeLink
from drivers.modbus_cnc.device import ModbusCnc
from drivers.modbus_cnc.settings import ModbusCncSettings
from drivers.roles import MotionState
from simulators.wire.pty_port import PseudoTerminal

FAR = np.array([1000.0, 0.0, 0.0])
STOP_COMMAND = 23
"""Code of STOP in docs/reference/modbus-register-map.md."""
MOVE_FEED_COMMAND = 12
HELLO = {"hello": [{"ok": {"protocol": 1}}]}
QUICK_STOPS = tuple((0x600 + node, bytes.fromhex("2B 40 60 00 02 00 00 00")) for node in (5, 6))


@pytest.fixture
def grbl(tmp_path: Path) -> Iterator[Rig]:
    with serial_rig(tmp_path) as made:
        made.device.open()
        yield made


class Stall:
    """Peer on a pseudo-terminal that reads nothing more; everything that the line can hold is already in it."""

    def __init__(self, grbl: Rig) -> None:
        self._line = grbl.port.line
        self._released, self._entered = threading.Event(), threading.Event()
        self._original = self._line._received

    def begin(self) -> None:
        self._line._received = self._held
        os.write(self._line._theirs, b" ")
        assert self._entered.wait(30.0)
        os.set_blocking(self._line._theirs, False)
        for _ in range(10):  # the kernel moves data on in the background
            with suppress(BlockingIOError):
                for size in [64] * 4096 + [1] * 64:
                    os.write(self._line._theirs, b" " * size)
            threading.Event().wait(0.01)

    def release(self) -> None:
        self._line._received = self._original
        self._released.set()

    def _held(self, data: bytes) -> None:
        self._entered.set()
        self._released.wait()
        self._original(data)


def rests(grbl: Rig) -> bool:
    """Return True if the controller is told to hold within the wall time of a slow computer, and then rests."""
    ends_s = wall_seconds() + 30.0
    while grbl.world.controller.motion is MotionState.MOVING and wall_seconds() < ends_s:
        with grbl.shared.lock:
            held = grbl.port.controller.state.value == "Hold"
        if held:
            grbl.clock.sleep(5.0)
        threading.Event().wait(0.005)
    return grbl.world.controller.motion is not MotionState.MOVING


class TestSerial:
    def test_line_that_accepts_nothing(self, grbl: Rig) -> None:
        stall = Stall(grbl)
        grbl.at(3.0, stall.begin)
        grbl.at(3.5, stall.begin)
        with pytest.raises(LinkTimeout, match="accepts no data") as caught:
            grbl.device.move_to(FAR, feed_mm_per_s=50.0, guarded=False)
        assert "a feed hold was sent" in caught.value.__notes__[0]
        assert grbl.clock.now() < 5.0
        stall.release()
        assert rests(grbl)
        assert 100.0 < grbl.world.controller.displayed_position()[0] < 400.0
        grbl.device.status()  # the second phase of the stop
        assert grbl.device.status().state is MotionState.IDLE

    def test_stop_command_on_a_line_that_accepts_nothing_is_quick(self, grbl: Rig) -> None:
        stall = Stall(grbl)
        grbl.at(3.0, stall.begin)
        took_s: list[float] = []

        def stop() -> None:
            began_s = wall_seconds()
            with pytest.raises(DeviceError):
                grbl.device.stop()
            took_s.append(wall_seconds() - began_s)
            stall.release()

        grbl.at(3.0, stop)
        with pytest.raises(DeviceError):
            grbl.device.move_to(FAR, feed_mm_per_s=50.0, guarded=False)
        assert took_s[0] < 30.0
        assert rests(grbl)

    def test_replugged_line(self, grbl: Rig) -> None:
        grbl.at(3.0, lambda: replug(grbl))
        with pytest.raises(LinkLost) as caught:
            grbl.device.move_to(FAR, feed_mm_per_s=50.0, guarded=False)
        assert not getattr(caught.value, "__notes__", []), "the stop was sent on a new connection"
        assert rests(grbl)
        grbl.device.status()
        assert grbl.device.status().state is MotionState.IDLE
        grbl.device.move_to(np.array([10.0, 0.0, 0.0]), feed_mm_per_s=50.0, guarded=False)

    def test_line_that_stays_unplugged_says_that_no_stop_was_sent(self, grbl: Rig) -> None:
        grbl.at(3.0, grbl.port.line.close)
        with pytest.raises(LinkLost) as caught:
            grbl.device.move_to(FAR, feed_mm_per_s=50.0, guarded=False)
        assert "the feed hold could not be sent" in caught.value.__notes__[0]
        with pytest.raises(LinkLost, match="cannot be opened"):
            grbl.device.stop()

    def test_stop_after_a_replug_of_an_unused_line(self, grbl: Rig) -> None:
        grbl.type(b"G53G1X-100F6000\n")
        replug(grbl)
        grbl.device.stop()
        assert rests(grbl)

    def test_stop_while_another_program_has_locked_the_replugged_port(self, grbl: Rig) -> None:
        grbl.type(b"G53G1X-100F6000\n")
        replug(grbl)
        with closing(Serial(grbl.port.line.device_path, exclusive=True)):
            with pytest.raises(LinkLost, match="no other program uses it"):
                SerialPort(SerialAddress(grbl.port.line.device_path, 115_200)).open()
            grbl.device.stop()
            assert rests(grbl)


def replug(grbl: Rig) -> None:
    """Pull the cable out and plug it in again: the port has the same name, but is another one."""
    old, controller = grbl.port.line, grbl.port.controller
    link = old.device_path
    old.close()
    new = PseudoTerminal("grbl", grbl.port._received, link)
    grbl.port.line, grbl.port.close = new, new.close
    controller._send = new.send
    new.start()


class SlowPlc(FakePlc):
    """PLC whose program runs once in `requests_per_cycle` requests, and which handles the command that it has taken
    `deciding_cycles` later, as the map allows."""

    requests_per_cycle, deciding_cycles = 1, 0

    def __init__(self) -> None:
        self._answering, self._asked = False, 0
        self._taken: tuple[list[int], int] | None = None
        super().__init__()

    def cycle(self) -> None:
        if not self._answering:
            super().cycle()

    def _pdu(self, pdu: bytes) -> bytes:
        self._answering = True
        answer = super()._pdu(pdu)
        self._answering = False
        self._asked += 1
        if self._asked % self.requests_per_cycle == 0:
            self.cycle()
        return answer

    def _take_command(self) -> None:
        if self._taken is None and self.registers[2022] not in (0, self.handled):
            self._taken = self.registers[2000:2023], self.deciding_cycles
        if self._taken is None:
            return
        block, cycles = self._taken
        if cycles:
            self._taken = block, cycles - 1
            return
        present, self.registers[2000:2023], self._taken = self.registers[2000:2023], block, None
        super()._take_command()
        self.registers[2000:2023] = present


class TestModbus:
    @pytest.fixture
    def plc(self) -> Iterator[SlowPlc]:
        with closing(SlowPlc()) as plc:
            yield plc

    def test_stop_has_a_number_of_its_own_if_the_connection_was_lost_before_the_motion_was_acknowledged(
        self, plc: SlowPlc
    ) -> None:
        clock = VirtualClock()
        clock.subscribe(plc.advance_to)
        plc.deciding_cycles = 3

        def drop(request: bytes, answer: bytes) -> bytes | None:
            if plc.registers[2001] != MOVE_FEED_COMMAND:
                return answer
            plc.disturb = lambda _request, answer: answer
            plc.drop_client()
            return None

        with opened(plc, clock, reconnect_attempts=0) as cnc:
            plc.disturb = drop
            with pytest.raises(LinkLost):
                cnc.move_to(FAR, feed_mm_per_s=10.0, guarded=False)
            cnc.stop()
            assert plc.commands == [MOVE_FEED_COMMAND, STOP_COMMAND]
            clock.sleep(0.1)
            assert cnc.status().state is MotionState.IDLE
            cnc.move_to(np.array([110.0, 200.0, 300.0]), feed_mm_per_s=10.0, guarded=False)

    @pytest.mark.parametrize("requests", [1, 2, 3, 4])
    def test_abort_before_the_acknowledgement_of_a_motion_does_not_find_another_client(
        self, plc: SlowPlc, requests: int
    ) -> None:
        """The acknowledgement of the motion may be read after the STOP has been sent."""
        plc.requests_per_cycle = requests
        inner = VirtualClock()
        inner.subscribe(plc.advance_to)
        pressed: list[bool] = []

        def check() -> None:
            if plc.commands == [MOVE_FEED_COMMAND] and not pressed:
                pressed.append(True)
                raise Aborted("pressed")

        with opened(plc, InterruptibleClock(inner, check)) as cnc:
            with pytest.raises(Aborted) as caught:
                cnc.move_to(FAR, feed_mm_per_s=10.0, guarded=False)
            assert not getattr(caught.value, "__notes__", [])
            cnc.stop()
            assert cnc.status().state is MotionState.IDLE
            assert plc.commands == [MOVE_FEED_COMMAND, STOP_COMMAND, STOP_COMMAND]

    def test_connection_that_answers_nothing_is_replaced(self) -> None:
        clock = VirtualClock()
        with closing(FakePlc()) as plc:
            clock.subscribe(plc.advance_to)
            settings = ModbusCncSettings.model_validate(
                {"host": "127.0.0.1", "port": plc.port, "timeout_s": 0.5, "retries": 0}
            )
            device = ModbusCnc(settings, clock, "cnc")
            device.open()
            first = plc.connections
            stops: list[int] = []

            def stalled(request: bytes, answer: bytes) -> bytes | None:
                if plc.commands[-1:] == [STOP_COMMAND]:
                    stops.append(plc.connections)
                return None if plc.connections == first else answer

            def stall(now_s: float) -> None:
                if now_s > 0.5 and plc.disturb is not stalled:
                    plc.disturb = stalled

            clock.subscribe(stall)
            with pytest.raises(DeviceError):
                device.move_to(np.array([1100.0, 200.0, 300.0]), feed_mm_per_s=50.0, guarded=False)
            assert any(connection > first for connection in stops)
            assert clock.now() < 10.0
            device.close()


class TestCanopen:
    def test_lost_answer_does_not_hinder_the_stop(self) -> None:
        with canopen_rig(sdo_timeout_s=0.3) as bench:
            bench.axes.begin_turn("azimuth", 90.0, 1.0)
            bench.frames()
            bench.azimuth_node.receive = lambda *_: []  # type: ignore[method-assign]
            with suppress(DeviceError):
                bench.mount.stop()
            seen = bench.frames()
            assert all(stop in seen for stop in QUICK_STOPS)

    def test_adapter_that_has_left_the_bus_is_opened_again(self) -> None:
        with canopen_rig() as bench:
            bus_off = can.Message(arbitration_id=0x40, is_error_frame=True, data=bytes(8))

            def leave(now_s: float) -> None:
                if now_s >= 2.0 and not left:
                    left.append(now_s)
                    bench.sniffer.send(bus_off)

            left: list[float] = []
            bench.clock.subscribe(leave)
            with pytest.raises(LinkLost, match="gone off the bus"):
                bench.mount.orient_to(90.0, 30.0)
            seen = bench.frames()
            assert all(stop in seen for stop in QUICK_STOPS)
            assert not bench.axes.turns
            bench.mount.close()
            bench.mount.open()


class TestLinuxCnc:
    """LinuxCNC itself is tested in tests/linuxcnc; here only the bridge process fails."""

    @pytest.fixture
    def link(self, tmp_path: Path) -> Iterator[Callable[[object], BridgeLink]]:
        made: list[BridgeLink] = []

        def of(answer: object) -> BridgeLink:
            file = tmp_path / "script.json"
            file.write_text(json.dumps({**HELLO, "abort": [answer]}), encoding="utf-8")
            command = (sys.executable, str(Path(__file__).with_name("linuxcnc_fake_bridge.py")), str(file))
            made.append(
                BridgeLink(
                    command, response_timeout_s=5.0, watchdog_timeout_s=0.0, heartbeat_timeout_s=1.0, device="cnc"
                )
            )
            made[-1].open()
            file.write_text(json.dumps({**HELLO, "abort": [{"ok": {}}]}), encoding="utf-8")
            return made[-1]

        yield of
        for one in made:
            one.close()

    @pytest.mark.parametrize("answer", ["hang", "die"])
    def test_bridge_that_fails_at_the_abort_itself_is_replaced(
        self, link: Callable[[object], BridgeLink], answer: str
    ) -> None:
        failing = link(answer)
        before = failing.pid
        failing.abort()
        assert failing.pid != before
