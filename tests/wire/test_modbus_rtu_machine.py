"""Simulated controller on a serial line: paced, without answer at another baud rate or to invalid requests.

Also the driver on a line that loses, cuts, garbles, doubles and delays frames.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from contextlib import closing

import numpy as np
import pytest
import serial
from modbus_fakes import FakeController, FakeWorld
from rtu_slave import RtuSlave, crc, framed

from drivers.clock import RealClock, VirtualClock, wall_seconds
from drivers.errors import DeviceError
from drivers.modbus_cnc.device import ModbusCnc
from drivers.modbus_cnc.settings import ModbusCncSettings
from drivers.roles import TableImage, Touch
from simulators.wire.modbus.controller import attach_registers
from simulators.wire.modbus.frames import answer_request
from simulators.wire.modbus.rtu import InvalidFrameError, LineSettings, ModbusRtuController, frame_crc, take_request
from simulators.wire.shared_world import SharedWorld

READ_PROTOCOL = framed("01 03 03E8 0002")
PROTOCOL = framed("01 03 04 5643 0100")


@pytest.fixture
def controller(request: pytest.FixtureRequest) -> Iterator[ModbusRtuController]:
    clock = getattr(request, "param", None)
    served = ModbusRtuController(SharedWorld(FakeWorld()), LineSettings(baud=9600), clock=clock)
    served.start()
    with closing(served):
        yield served


def asked(controller: ModbusRtuController, *requests: bytes, baud: int = 9600, silent_s: float = 0.15) -> bytes:
    """Return everything received until the line has been silent for a while."""
    with serial.Serial(controller.agent_settings["serial"]["port"], baud, timeout=silent_s) as port:
        for request in requests:
            port.write(request)
        answer = b""
        while more := port.read(256):
            answer += more
        return answer


def test_the_standards_crc_bit_by_bit() -> None:
    assert frame_crc(bytes.fromhex("02 07")) == bytes.fromhex("41 12")


def test_sound_requests_of_this_unit_are_answered(controller: ModbusRtuController) -> None:
    assert asked(controller, READ_PROTOCOL) == PROTOCOL
    assert asked(controller, framed("01 2B 0E01 00")) == framed("01 AB 01")
    assert asked(controller, framed("01 03 0000 0001")) == framed("01 83 02")


@pytest.mark.parametrize(
    "request_",
    [framed("02 03 03E8 0002"), framed("00 03 03E8 0002"), READ_PROTOCOL[:-1] + b"\0", READ_PROTOCOL[:-2], b"\xff"],
)
def test_what_is_not_for_it_or_not_sound_is_not_answered(controller: ModbusRtuController, request_: bytes) -> None:
    assert asked(controller, request_) == b""
    assert asked(controller, READ_PROTOCOL) == PROTOCOL  # and it has recovered


def test_another_baud_rate_is_not_understood(controller: ModbusRtuController) -> None:
    assert asked(controller, READ_PROTOCOL, baud=19200) == b""
    assert asked(controller, READ_PROTOCOL) == PROTOCOL


@pytest.mark.parametrize("controller", [RealClock()], indirect=True)
def test_on_a_clock_of_its_own_the_line_is_truly_paced(controller: ModbusRtuController) -> None:
    request = framed("01 03 03E8 0046")
    started_s = wall_seconds()
    with serial.Serial(controller.agent_settings["serial"]["port"], 9600, timeout=600.0) as port:
        port.write(request)
        assert len(port.read(145)) == 145
    assert wall_seconds() - started_s >= (8 + 145) * 11 / 9600 + 3.5 * 11 / 9600


def test_a_frame_that_is_longer_than_the_standard_allows_is_none() -> None:
    body = bytes.fromhex("01 10 07D0 007B F8") + bytes(248)
    buffer = bytearray(body + crc(body))
    with pytest.raises(InvalidFrameError):
        take_request(buffer)
    assert not buffer


def test_the_wall_is_touched_over_the_serial_line(controller: ModbusRtuController) -> None:
    """One row of the contract with the fake world: the request arrives complete."""
    clock = VirtualClock()
    clock.subscribe(controller._shared.advance_to)
    physics = controller._shared.world.controller
    assert isinstance(physics, FakeController)
    physics.wall_y = 200.0
    settings = ModbusCncSettings.model_validate(controller.agent_settings)
    with closing(ModbusCnc(settings, clock, "cnc")) as cnc:
        cnc.open()
        touch = cnc.touch_towards(np.array([0.0, 400.0, 0.0]), feed_mm_per_s=50.0)
    assert isinstance(touch, Touch)
    assert touch.position_mm == pytest.approx((0.0, 200.0, 0.0))


NOISE: list[Callable[[bytes], bytes | None]] = [
    lambda _frame: None,
    lambda frame: frame[: len(frame) // 2],
    lambda frame: frame[:5] + bytes((frame[5 % len(frame)] ^ 4,)) + frame[6:],
    lambda frame: frame + frame,
    lambda frame: b"\0" + frame,
]


@pytest.mark.parametrize("seed", range(6))
def test_on_a_bad_line_what_comes_out_is_right_or_an_error(seed: int) -> None:
    """Every sixth answer is lost, cut, garbled, doubled or preceded by a glitch; every tenth request is lost.

    Each motion is carried out once.
    """
    drawn = random.Random(seed)  # noqa: S311  not for secrets
    shared = SharedWorld(FakeWorld())
    registers = attach_registers(shared)
    shared.world.controller.wall_y = 200.0

    def answer(request: bytes) -> bytes | None:
        if crc(request[:-2]) != request[-2:] or drawn.random() < 0.1:
            return None
        with shared.lock:
            body = request[:1] + answer_request(request[1:-2], registers)
        frame = body + crc(body)
        return drawn.choice(NOISE)(frame) if drawn.random() < 1 / 6 else frame

    clock = VirtualClock()
    clock.subscribe(shared.advance_to)
    counts = np.arange(4 * 3 * 3 * 3, dtype=np.int32).reshape(4, 3, 3, 3)
    table = TableImage((0.0, 0.0, 0.0), (1000.0, 600.0, 700.0), 1e-4, counts)
    with closing(RtuSlave(answer)) as slave:
        line = {"port": slave.port, "baud": 115200}
        settings = ModbusCncSettings.model_validate({"serial": line, "timeout_s": 0.03, "retries": 10})
        with closing(ModbusCnc(settings, clock, "cnc")) as cnc:
            try:
                cnc.open()
                for x in (100.0, 300.0):
                    cnc.move_to(np.array([x, 0.0, 10.0]), feed_mm_per_s=None, guarded=False)
                    assert cnc.position() == pytest.approx([x, 0.0, 10.0])
                    touch = cnc.touch_towards(np.array([x, 400.0, 10.0]), feed_mm_per_s=100.0)
                    assert touch.position_mm == pytest.approx((x, 200.0, 10.0))
                cnc.stage(1, table)
                cnc.activate(1)
            except DeviceError as error:
                pytest.fail(f"ten repetitions were not enough: {error}")
            assert cnc.active_bank() == 1
            assert shared.world.controller.banks[1].same_as(table)
    assert [(kind, target[0]) for kind, target, _ in shared.world.controller.orders] == [
        ("move", 100.0), ("touch", 100.0), ("move", 300.0), ("touch", 300.0),
    ]  # fmt: skip
