"""Modbus TCP has no checksum: one altered byte at rest is read again, and what stays wrong is named."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from functools import partial

import numpy as np
import pytest
from modbus_plc import FakePlc
from modbus_rig import opened as opened_with

from drivers.clock import VirtualClock
from drivers.errors import CommandRejected, MotionFault, ProtocolError
from drivers.modbus_cnc.device import ModbusCnc

TARGET = np.array([150.0, 200.0, 300.0])
START = [100.0, 200.0, 300.0]
HEADER = 9  # transaction, protocol, length, unit, function, byte count
STATUS = 1000
POSITION = range(HEADER + 24, HEADER + 48)
"""Bytes of the answer that hold the position: nothing protects them, and any value may be true."""

opened = partial(opened_with, timeout_s=0.05)


@pytest.fixture
def cnc(plc: FakePlc, clock: VirtualClock) -> Iterator[ModbusCnc]:
    with opened(plc, clock) as device:
        yield device


def alter_once(plc: FakePlc, at: int, bit: int) -> None:
    """Alter one bit of the byte `at` of the next answer."""

    def disturb(_request: bytes, answer: bytes) -> bytes:
        plc.disturb = lambda _request, answer: answer
        return answer[:at] + bytes([answer[at] ^ 1 << bit]) + answer[at + 1 :]

    plc.disturb = disturb


@pytest.mark.parametrize("bit", [0, 7])
def test_one_altered_byte_of_an_answer_ends_nothing(cnc: ModbusCnc, plc: FakePlc, bit: int) -> None:
    cnc.stop()
    length = HEADER + 2 * 70
    for at in range(length):
        if at not in POSITION:
            alter_once(plc, at, bit)
            assert cnc.position().tolist() == START, at
    assert plc.commands == [23]


@pytest.mark.parametrize("code", [1, 2, 3])
def test_a_request_whose_address_was_altered_is_sent_again(cnc: ModbusCnc, plc: FakePlc, code: int) -> None:
    def refuse(request: bytes, answer: bytes) -> bytes:
        plc.disturb = lambda _request, answer: answer
        return answer[:4] + struct.pack(">HBBB", 3, request[6], request[7] | 0x80, code)

    cnc.move_to(TARGET, feed_mm_per_s=None, guarded=False)
    plc.disturb = refuse
    assert cnc.position().tolist() == TARGET.tolist()
    plc.disturb = refuse
    cnc.move_to(TARGET + 10.0, feed_mm_per_s=None, guarded=False)
    assert plc.commands == [11, 11]


def test_a_request_that_is_always_refused_names_both_causes(cnc: ModbusCnc, plc: FakePlc) -> None:
    cnc.position()
    plc.disturb = lambda request, answer: answer[:4] + struct.pack(">HBBB", 3, request[6], request[7] | 0x80, 2)
    with pytest.raises(ProtocolError, match=r"carried out before is refused: Modbus exception 2.*altered on the way"):
        cnc.position()


def test_a_restart_with_the_link_kept_is_named_at_rest(cnc: ModbusCnc, plc: FakePlc) -> None:
    cnc.stop()
    plc.registers[1008] = plc.registers[1010] = plc.registers[2022] = 0
    with pytest.raises(ProtocolError, match=r"the controller was restarted.*reference the axes"):
        cnc.position()


def test_a_restart_with_the_link_kept_is_named_in_a_motion(cnc: ModbusCnc, plc: FakePlc) -> None:
    cnc.stop()

    def restart(_request: bytes, answer: bytes) -> bytes:
        if plc.motion is not None and plc.now_s > began_s:
            plc.motion = None
            plc.registers[1004] = 1
            plc.registers[1008] = plc.registers[1010] = plc.registers[1011] = plc.registers[2022] = 0
        return answer

    began_s = plc.now_s
    plc.disturb = restart
    with pytest.raises((ProtocolError, MotionFault), match=r"restarted.*reference the axes") as caught:
        cnc.move_to(TARGET, feed_mm_per_s=10.0, guarded=False)
    assert "register map" not in str(caught.value)


@pytest.mark.parametrize(("words", "at"), [("position", 12), ("latched", 26)])
def test_words_of_one_value_in_another_order_are_named(cnc: ModbusCnc, plc: FakePlc, words: str, at: int) -> None:
    def swap(_request: bytes, answer: bytes) -> bytes:
        where = HEADER + 2 * at
        values = b"".join(
            struct.pack(">4H", *reversed(struct.unpack(">4H", struct.pack(">d", value)))) for value in START
        )
        return answer[:where] + values + answer[where + 24 :] if answer[8] == 140 else answer

    plc.disturb = swap
    with pytest.raises(ProtocolError, match=rf"illegal {words}.*would be 100.000, 200.000, 300.000 mm.*'low-first'"):
        cnc.position()


def test_a_target_refused_although_it_lies_in_the_stated_travel_is_explained(cnc: ModbusCnc, plc: FakePlc) -> None:
    plc.upper = (120.0, 1300.0, 1500.0)  # the controller's own limit, which LIMITS did not state
    with pytest.raises(CommandRejected, match=r"lies within the travel that the controller states.*word order"):
        cnc.move_to(TARGET, feed_mm_per_s=None, guarded=False)
