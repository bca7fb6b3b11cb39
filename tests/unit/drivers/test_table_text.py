"""Tests of the text format of tables: values are preserved exactly, truncated or changed texts are refused."""

from __future__ import annotations

import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from drivers.errors import ChecksumMismatch, StoreError
from drivers.roles import Activation, StoreLimits, TableImage
from drivers.tables.checks import limits_violation, table_defect
from drivers.tables.files import read_if_exists, write_atomically
from drivers.tables.text import format_table, parse_table

numbers = st.floats(-1e6, 1e6, allow_nan=False)
steps = st.floats(1e-3, 1e5)


@st.composite
def tables(draw: st.DrawFn) -> TableImage:
    shape = draw(st.tuples(st.integers(1, 4), st.integers(1, 4), st.integers(1, 4)))
    counts = draw(arrays(np.int32, (*shape, 3)))
    origin = draw(st.tuples(numbers, numbers, numbers))
    step = draw(st.tuples(steps, steps, steps))
    return TableImage(origin, step, draw(st.floats(1e-7, 1e-2)), counts)


@given(tables())
def test_every_bit_comes_back(table: TableImage) -> None:
    assert parse_table(format_table(table)).same_as(table)


@given(tables(), st.data())
def test_truncated_text_is_refused(table: TableImage, data: st.DataObject) -> None:
    text = format_table(table)
    with pytest.raises(StoreError):
        parse_table(text[: data.draw(st.integers(0, len(text) - 1))])


@given(tables(), st.data())
def test_changed_byte_is_noticed(table: TableImage, data: st.DataObject) -> None:
    text = format_table(table)
    at = data.draw(st.integers(0, len(text) - 1))
    other = data.draw(st.characters(min_codepoint=0, max_codepoint=255).filter(lambda c: c != text[at]))
    with pytest.raises(StoreError):
        parse_table(text[:at] + other + text[at + 1 :], file="bank1.table")


def signed(body: str) -> str:
    """Return `body` with a correct checksum line: the content is wrong, but not damaged."""
    return f"{body}file_crc32 {zlib.crc32(body.encode()):08X}\n"


GOOD = format_table(TableImage((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 1e-4, np.zeros((1, 1, 2, 3), dtype=np.int32)))
BODY = GOOD[: GOOD.index("file_crc32")]


@pytest.mark.parametrize(
    "body",
    [
        BODY.replace("table 1", "table 2"),
        BODY.replace("nodes 1 1 2", "nodes 1 1 3"),
        BODY.replace("nodes 1 1 2", "nodes 1 1"),
        BODY.replace("origin_mm 0.0", "origin_mm zero"),
        BODY + "0 0 0\n",
        BODY.replace("0 0 0\n", "0 0 9999999999\n", 1),
        BODY.replace("0 0 0\n", "0 0 x\n", 1),
        BODY.replace("0 0 0\n0 0 0\n", "0 0 0 0 0 0\n"),
    ],
)
def test_inconsistent_text_is_refused(body: str) -> None:
    with pytest.raises(StoreError) as caught:
        parse_table(signed(body), file="bank1.table")
    assert caught.value.where["file"] == "bank1.table"
    assert caught.value.hint


def test_changed_text_is_a_checksum_mismatch() -> None:
    with pytest.raises(ChecksumMismatch):
        parse_table(GOOD.replace("step_mm 1.0", "step_mm 2.0"))


LIMITS = StoreLimits((1, 2), (4, 4, 4), 32, 1e-4, 0.1, Activation.IMMEDIATE)


def image(counts: np.ndarray, step: float = 10.0, resolution: float = 1e-4) -> TableImage:
    return TableImage((0.0, 0.0, 0.0), (step, step, step), resolution, counts.astype(np.int32))


@pytest.mark.parametrize(
    ("table", "said"),
    [
        (image(np.zeros((5, 1, 1, 3))), "exceeds"),
        (image(np.zeros((4, 4, 4, 3))), "exceeds"),
        (image(np.zeros((2, 2, 2, 3)), resolution=1e-3), "one count"),
        (image(np.full((2, 2, 2, 3), -1001)), "largest"),
        (image(np.full((2, 2, 2, 3), 1000)), ""),
    ],
)
def test_table_that_a_store_cannot_take(table: TableImage, said: str) -> None:
    objection = limits_violation(LIMITS, table)
    assert said in objection
    assert bool(objection) == bool(said)


def test_invalid_grid() -> None:
    steep = np.zeros((2, 2, 2, 3))
    steep[1] = 1000
    assert table_defect(image(steep), 0.01) == ""
    assert "along X" in table_defect(image(steep), 0.0099)
    assert "no nodes" in table_defect(image(np.zeros((0, 2, 2, 3))), 1.0)
    for step in (0.0, -1.0, float("nan"), float("inf")):
        assert "do not define a grid" in table_defect(image(np.zeros((2, 2, 2, 3)), step=step), 1.0)


def test_file_is_complete_or_absent(tmp_path: Path) -> None:
    file = tmp_path / "bank1.table"
    assert read_if_exists(file) is None
    write_atomically(file, "first")
    with pytest.raises(StoreError, match="cannot write"):
        write_atomically(tmp_path / "nowhere" / "bank1.table", "second")
    (tmp_path / "bank1.table.part").mkdir()
    with pytest.raises(StoreError, match="cannot write"):
        write_atomically(file, "second")
    assert read_if_exists(file) == "first"
    with pytest.raises(StoreError, match="cannot read"):
        read_if_exists(tmp_path)
