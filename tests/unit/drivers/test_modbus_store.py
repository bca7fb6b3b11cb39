"""Tests of compensation tables over Modbus: transfer, commit, read-back, two-step activation."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from modbus_plc import FakePlc
from modbus_rig import opened

from drivers.clock import VirtualClock
from drivers.errors import ChecksumMismatch, LinkLost, ProtocolError, ReadBackMismatch, StoreError
from drivers.modbus_cnc.codec import NumberFormat
from drivers.modbus_cnc.device import ModbusCnc
from drivers.modbus_cnc.registers import BlockLayouts
from drivers.modbus_cnc.store import block_count, data_blocks, table_bytes
from drivers.roles import Activation, TableImage


@pytest.fixture
def cnc(plc: FakePlc, clock: VirtualClock) -> Iterator[ModbusCnc]:
    """Driver that waits long for the many answers of a transfer."""
    with opened(plc, clock, timeout_s=5.0) as device:
        yield device


def table_of(shape: tuple[int, int, int], seed: int = 1) -> TableImage:
    counts = np.random.default_rng(seed).integers(-5000, 5000, (*shape, 3), dtype=np.int32)
    return TableImage((0.0, -1.5, 2.25), (68.4, 100.0, 10.0), 0.0001, counts)


def test_limits_say_what_the_store_can_represent(cnc: ModbusCnc) -> None:
    limits = cnc.store_limits()
    assert limits.banks == (1, 2)
    assert limits.max_nodes == (60, 20, 20)
    assert (limits.max_total_nodes, limits.resolution_mm, limits.max_correction_mm) == (24000, 0.0001, 0.5)
    assert limits.activation is Activation.IMMEDIATE


# 20 nodes fill a block: one short of it, exactly one, one more, and a larger grid
@pytest.mark.parametrize("shape", [(1, 1, 19), (4, 5, 1), (3, 7, 1), (9, 6, 5)])
def test_a_staged_table_comes_back_and_becomes_active(
    cnc: ModbusCnc, plc: FakePlc, shape: tuple[int, int, int]
) -> None:
    table = table_of(shape)
    cnc.stage(2, table)
    seen = cnc.read_table(2)
    assert seen is not None
    assert seen.same_as(table)
    assert cnc.active_bank() == 0
    cnc.activate(2)
    assert cnc.active_bank() == 2
    assert plc.commands == [31, 32, 33, 34]
    cnc.activate(0)
    assert cnc.active_bank() == 0


def test_the_order_of_the_data_is_x_slowest_then_y_z_and_component() -> None:
    counts = np.zeros((2, 2, 2, 3), dtype=np.int32)
    expected = b""
    value = 0
    for x in range(2):
        for y in range(2):
            for z in range(2):
                for component in range(3):
                    value += 1
                    counts[x, y, z, component] = -value
                    expected += (2**32 - value).to_bytes(4, "big")
    assert table_bytes(TableImage((0.0,) * 3, (1.0,) * 3, 0.001, counts)) == expected


@given(st.integers(1, 60), st.integers(1, 20), st.integers(1, 20))
def test_the_number_of_blocks_fits_the_data(nx: int, ny: int, nz: int) -> None:
    data = bytes(12 * nx * ny * nz)
    blocks = list(data_blocks(data))
    assert len(blocks) == block_count((nx, ny, nz))
    assert {len(block) for block in blocks} == {240}
    assert 0 <= len(blocks) * 240 - len(data) < 240


def test_an_empty_bank_and_bank_0_hold_no_table(cnc: ModbusCnc) -> None:
    assert cnc.read_table(0) is None
    assert cnc.read_table(1) is None


def test_a_damaged_active_bank_is_an_error(cnc: ModbusCnc, plc: FakePlc) -> None:
    plc.registers[1038], plc.registers[1046] = 1, 3
    with pytest.raises(StoreError, match="active bank 1 holds no complete table"):
        cnc.read_table(1)


@pytest.mark.parametrize("bank", [3, 24066, 0xFFFE])
def test_a_bank_that_the_controller_does_not_have_is_no_answer(cnc: ModbusCnc, plc: FakePlc, bank: int) -> None:
    """An altered answer over Modbus TCP, which has no checksum."""
    plc.registers[1038] = bank
    with pytest.raises(ProtocolError, match=f"names bank {bank}, but it has 2 banks"):
        cnc.active_bank()
    plc.registers[1038], plc.registers[1043] = 0, bank
    with pytest.raises(ProtocolError, match=f"names bank {bank}, but it has 2 banks"):
        cnc.pending_bank()


def test_a_descriptor_with_more_nodes_than_the_controller_has_is_refused_at_once(cnc: ModbusCnc, plc: FakePlc) -> None:
    """Its blocks would be read for years."""
    nodes_at = 9 + 4 + 2 * BlockLayouts(NumberFormat("float64")).descriptor.offset("nodes")

    def claim_many_nodes(_: bytes, answer: bytes) -> bytes:
        shows_descriptor = answer[7] == 23 and answer[9:13] == bytes([0, 1, 0, 0])
        return answer[:nodes_at] + b"\xff" * 6 + answer[nodes_at + 6 :] if shows_descriptor else answer

    cnc.stage(1, table_of((2, 2, 2)))
    plc.disturb = claim_many_nodes
    before = len(plc.requests)
    with pytest.raises(ProtocolError, match=r"the descriptor of bank 1 is invalid: .*65535, 65535, 65535"):
        cnc.read_table(1)
    assert len(plc.requests) - before < 10


def test_the_active_bank_is_never_written(cnc: ModbusCnc, plc: FakePlc) -> None:
    cnc.stage(1, table_of((2, 2, 2)))
    cnc.activate(1)
    before = len(plc.commands)
    with pytest.raises(StoreError, match="bank 1 is active"):
        cnc.stage(1, table_of((2, 2, 2), seed=2))
    assert len(plc.commands) == before


@pytest.mark.parametrize("bank", [0, 3, -1])
def test_only_banks_of_the_controller_can_be_staged(cnc: ModbusCnc, bank: int) -> None:
    with pytest.raises(StoreError, match=f"no bank {bank}"):
        cnc.stage(bank, table_of((2, 2, 2)))


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"counts": np.zeros((61, 1, 1, 3), np.int32)}, "grid"),
        ({"resolution_mm": 0.001}, "one count of the table is 0.001 mm"),
        ({"counts": np.full((1, 1, 1, 3), -5001, np.int32)}, "exceeds the largest"),
        ({"counts": np.full((1, 1, 1, 3), -(2**31), np.int32)}, "exceeds the largest"),
    ],
)
def test_a_table_beyond_the_limits_is_refused_before_anything_is_sent(
    cnc: ModbusCnc, plc: FakePlc, change: dict[str, Any], text: str
) -> None:
    with pytest.raises(StoreError, match=text):
        cnc.stage(1, replace(table_of((2, 2, 2)), **change))
    assert plc.commands == []


def test_data_corrupted_on_the_way_fails_the_commit(cnc: ModbusCnc, plc: FakePlc) -> None:
    taken = plc._take_block

    def take_with_a_flipped_bit() -> None:
        if plc.registers[2320] == 2:
            plc.registers[2211] ^= 1
        taken()

    plc._take_block = take_with_a_flipped_bit  # type: ignore[method-assign]
    with pytest.raises(ChecksumMismatch, match=r"TABLE COMMIT refused: CRC-32 differs"):
        cnc.stage(1, table_of((5, 5, 2)))
    assert cnc.active_bank() == 0
    assert cnc.read_table(1) is None


def test_data_changed_after_the_commit_is_detected_by_reading_back(cnc: ModbusCnc, plc: FakePlc) -> None:
    def flip(counts: list[int]) -> None:
        counts[0] ^= 0x0100_0000

    plc.corrupt_data = flip
    with pytest.raises(ChecksumMismatch, match="CRC-32 of the data read"):
        cnc.stage(1, table_of((5, 5, 2)))


def test_another_table_with_a_right_checksum_is_a_read_back_mismatch(cnc: ModbusCnc, plc: FakePlc) -> None:
    begin = plc._begin_table

    def begin_with_another_origin(bank: int, _crc: int) -> int:
        plc.put_numbers(2104, 17.0)
        return begin(bank, _crc)

    plc._begin_table = begin_with_another_origin  # type: ignore[method-assign]
    with pytest.raises(ReadBackMismatch, match="bank 1 reads back differently"):
        cnc.stage(1, table_of((5, 5, 2)))


def test_a_block_that_is_refused_names_number_and_reason(cnc: ModbusCnc, plc: FakePlc) -> None:
    def refuse() -> None:
        if plc.registers[2320] == 2:
            plc.registers[1045] = 7

    taken = plc._take_block
    plc._take_block = lambda: refuse() if plc.registers[2320] == 2 else taken()  # type: ignore[method-assign]
    with pytest.raises(StoreError, match=r"data block 2 refused: illegal value \(code 7\)"):
        cnc.stage(1, table_of((5, 5, 2)))


def test_a_lost_block_answer_is_sent_again_and_taken_once(cnc: ModbusCnc, plc: FakePlc) -> None:
    lost: list[bytes] = []

    def lose_block_2(request: bytes, answer: bytes) -> bytes | None:
        if request[7] == 23 and request[12:14] == (2200).to_bytes(2, "big") and request[-1] == 2 and not lost:
            lost.append(request)
            return None
        return answer

    plc.disturb = lose_block_2
    table = table_of((5, 5, 2))
    cnc.stage(1, table)
    assert lost
    seen = cnc.read_table(1)
    assert seen is not None
    assert seen.same_as(table)


def test_a_link_lost_in_the_middle_leaves_the_active_table(cnc: ModbusCnc, plc: FakePlc) -> None:
    def cut(request: bytes, answer: bytes) -> bytes:
        if request[7] == 23 and request[-1] == 3:
            plc.hang_up()
        return answer

    cnc.stage(1, table_of((2, 2, 2)))
    cnc.activate(1)
    plc.disturb = cut
    with pytest.raises(LinkLost):
        cnc.stage(2, table_of((5, 5, 5)))
    assert plc.registers[1038] == 1
    assert plc.registers[1047] == 1  # being written


def test_a_nonce_too_late_activates_nothing(cnc: ModbusCnc, plc: FakePlc) -> None:
    arm = plc._arm

    def arm_for_no_time(bank: int, crc: int) -> int:
        result = arm(bank, crc)
        plc.armed_until_s = -1.0
        return result

    plc._arm = arm_for_no_time  # type: ignore[method-assign]
    cnc.stage(1, table_of((2, 2, 2)))
    with pytest.raises(StoreError, match="TABLE ACTIVATE refused: not armed"):
        cnc.activate(1)
    assert cnc.active_bank() == 0


def test_an_arm_that_shows_another_bank_is_not_confirmed(cnc: ModbusCnc, plc: FakePlc) -> None:
    arm = plc._arm

    def arm_another(bank: int, crc: int) -> int:
        result = arm(bank, crc)
        plc.registers[1041] = 2
        return result

    plc._arm = arm_another  # type: ignore[method-assign]
    cnc.stage(1, table_of((2, 2, 2)))
    with pytest.raises(ProtocolError, match="armed bank 1, but the controller shows bank 2"):
        cnc.activate(1)
    assert 34 not in plc.commands


def test_an_empty_bank_cannot_be_activated(cnc: ModbusCnc) -> None:
    with pytest.raises(StoreError, match="bank 2 holds no complete table"):
        cnc.activate(2)
