"""Tests of settings, number formats and predicted durations of the Modbus driver."""

from __future__ import annotations

import math
from importlib.metadata import entry_points
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from drivers.clock import VirtualClock
from drivers.errors import LinkLost
from drivers.modbus_cnc.codec import NumberFormat, RegisterField, RegisterLayout
from drivers.modbus_cnc.plugin import PLUGIN
from drivers.modbus_cnc.session import PeerHeartbeat
from drivers.modbus_cnc.settings import BlockAddresses, ModbusCncSettings
from drivers.registry import ENTRY_POINT_GROUP, DeviceContext
from drivers.straight_move import move_duration_s

REGISTERS = [
    RegisterField("a", "u16"),
    RegisterField("b", "i32"),
    RegisterField("c", "number", 2),
    RegisterField("d", "u32"),
]


def test_overlapping_blocks_are_named() -> None:
    with pytest.raises(ValidationError, match=r"blocks status .1000 … 1069. and limits .1060 … 1122. overlap"):
        BlockAddresses(limits=1060)
    with pytest.raises(ValidationError, match="block command does not end before register 65536"):
        BlockAddresses(command=65530)


def test_unknown_keys_and_doubled_sensor_names_are_errors() -> None:
    with pytest.raises(ValidationError, match="Extra inputs"):
        ModbusCncSettings.model_validate({"host": "cnc", "hots": 1})
    with pytest.raises(ValidationError, match="a name occurs twice"):
        ModbusCncSettings(host="cnc", temperatures=("artefact", "artefact"))


def test_only_what_the_agent_has_to_write_may_be_written() -> None:
    written = {register for block in BlockAddresses().writable() for register in block}
    assert written == {*range(2000, 2023), *range(2100, 2134), *range(2200, 2321), 2400, 2401}


def test_the_plugin_is_installed_and_builds_a_device_that_is_not_yet_open() -> None:
    (entry,) = entry_points(group=ENTRY_POINT_GROUP, name="modbus-cnc")
    assert entry.load() is PLUGIN
    device = PLUGIN.create(PLUGIN.settings(host="127.0.0.1"), DeviceContext("cnc", VirtualClock(), Path()))
    with pytest.raises(LinkLost, match="device cnc"):
        device.position()


@pytest.mark.parametrize(
    ("numbers", "expected"),
    [
        (NumberFormat(), "0102 fffffffe 3ff8000000000000 c000000000000000 01020304"),
        (NumberFormat(word_order="low-first"), "0102 fffeffff 0000000000003ff8 000000000000c000 03040102"),
        (NumberFormat("int32", 0.001), "0102 fffffffe 000005dc00000000 fffff83000000000 01020304"),
        (
            NumberFormat("int32", 0.001, "low-first"),
            "0102 fffeffff 05dc000000000000 f830ffff00000000 03040102",
        ),
    ],
)
def test_every_number_format_has_its_bytes(numbers: NumberFormat, expected: str) -> None:
    layout = RegisterLayout(REGISTERS, numbers)
    values = (0x0102, -2, (1.5, -2.0), 0x01020304)
    assert layout.pack(values) == bytes.fromhex(expected)
    assert tuple(layout.unpack(bytes.fromhex(expected))) == values
    assert (layout.size, layout.offset("d")) == (13, 11)


def test_a_number_beyond_int32_is_refused() -> None:
    layout = RegisterLayout([RegisterField("x", "number")], NumberFormat("int32", 1e-5))
    with pytest.raises(ValueError, match="format requires"):
        layout.pack([30000.0])


def test_durations_follow_the_trapezoid() -> None:
    axes = {"rapid_mm_per_s": (500.0, 400.0, 300.0), "acceleration_mm_per_s2": (2000.0, 1000.0, 500.0)}
    # along X at rapid: 0.25 s up, 0.25 s down, 62.5 mm each, 875 mm at 500 mm/s
    along_x = move_duration_s((0, 0, 0), (1000, 0, 0), feed_mm_per_s=None, **axes)
    assert along_x == pytest.approx(0.25 + 0.25 + 875 / 500)
    # 10 mm in X never reach 500 mm/s: 2 sqrt(10 / 2000)
    assert move_duration_s((0, 0, 0), (10, 0, 0), feed_mm_per_s=None, **axes) == pytest.approx(0.141421356)
    # 45 degrees in Y and Z: Z limits, path speed 300 √2, path acceleration 500 √2, path 800 √2
    diagonal = move_duration_s((0, 0, 0), (0, 800, 800), feed_mm_per_s=None, **axes)
    assert diagonal == pytest.approx(800 / 300 + 300 / 500)
    assert move_duration_s((1, 2, 3), (1, 2, 3), feed_mm_per_s=5.0, **axes) == 0.0


@given(st.floats(0.1, 4000.0), st.floats(0.1, 1000.0))
def test_a_move_is_never_faster_than_its_feed(length: float, feed: float) -> None:
    axes = {"rapid_mm_per_s": (500.0,) * 3, "acceleration_mm_per_s2": (2000.0,) * 3}
    duration = move_duration_s((0, 0, 0), (length, 0, 0), feed_mm_per_s=feed, **axes)
    assert duration >= length / min(feed, 500.0) * (1 - 1e-12)
    assert duration >= math.sqrt(length / 2000.0)


def test_a_heartbeat_is_judged_only_while_it_is_watched() -> None:
    clock = VirtualClock()
    heartbeat = PeerHeartbeat(clock, 1.0, {"device": "cnc"})
    heartbeat.observe(5)
    clock.sleep(60.0)
    heartbeat.observe(5)  # a minute without an observation proves nothing
    for _ in range(2):
        clock.sleep(0.5)
        heartbeat.observe(5)
    clock.sleep(0.4)
    with pytest.raises(LinkLost, match=r"stuck at 5 for 1\.4 s .*device cnc"):
        heartbeat.observe(5)


def test_one_link_and_its_own_timeout() -> None:
    serial = {"port": "/dev/ttyUSB0"}
    assert ModbusCncSettings.model_validate({"serial": serial}).timeout_s == 0.25
    assert ModbusCncSettings.model_validate({"serial": serial, "timeout_s": 1.0}).timeout_s == 1.0
    assert ModbusCncSettings.model_validate({"host": "cnc"}).timeout_s == 0.5


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({}, "set either host"),
        ({"host": "cnc", "serial": {"port": "/dev/ttyS0"}}, "set either host"),
        ({"port": 502, "serial": {"port": "/dev/ttyS0"}}, "the serial port is serial.port"),
        ({"unit": 0, "serial": {"port": "/dev/ttyS0"}}, "1 to 247"),
        ({"unit": 248, "serial": {"port": "/dev/ttyS0"}}, "1 to 247"),
        ({"serial": {"port": "/dev/ttyS0", "baud": 300}}, "greater than or equal to 1200"),
        ({"serial": {"port": "/dev/ttyS0", "parity": "mark"}}, "'even', 'odd' or 'none'"),
        ({"serial": {"port": "/dev/ttyS0", "stop_bits": 3}}, "less than or equal to 2"),
        ({"serial": {"port": "/dev/ttyS0", "frame_gap_s": 0.0}}, "greater than 0"),
        ({"serial": {"baud": 9600}}, "Field required"),
    ],
)
def test_invalid_links(options: dict[str, object], text: str) -> None:
    with pytest.raises(ValidationError, match=text):
        ModbusCncSettings.model_validate(options)


@pytest.mark.parametrize(
    ("words", "bytes_", "hexed"),
    [
        ("high-first", "high-first", "0102 fffffffe 3ff8000000000000"),
        ("low-first", "high-first", "0102 fffeffff 0000000000003ff8"),
        ("high-first", "low-first", "0102 fffffeff f83f000000000000"),
        ("low-first", "low-first", "0102 feffffff 000000000000f83f"),
    ],
)
def test_four_orders_of_a_value(words, bytes_, hexed: str) -> None:
    """The values are 258, -2 and 1.5 (3FF8 0000 0000 0000)."""
    registers = [RegisterField("a", "u16"), RegisterField("b", "i32"), RegisterField("c", "number")]
    layout = RegisterLayout(registers, NumberFormat("float64", 1.0, words, bytes_))
    assert layout.pack((0x0102, -2, 1.5)) == bytes.fromhex(hexed)
    assert list(layout.unpack(bytes.fromhex(hexed))) == [0x0102, -2, 1.5]


def test_a_serial_line_has_one_master() -> None:
    serial = ModbusCncSettings.model_validate({"serial": {"port": "/dev/ttyS1"}})
    assert PLUGIN.claims(serial) == {"serial port /dev/ttyS1": "serial.port"}
    assert PLUGIN.claims(ModbusCncSettings(host="cnc")) == {}
