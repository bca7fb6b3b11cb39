"""Table files: bytes written by hand, round trips, and refusals."""

from __future__ import annotations

import json
import zlib

import numpy as np
import pytest

from twin.compensation.table import CompensationTable
from twin.compensation.table_file import checksum, format_side_file, format_table, parse_table
from twin.errors import FormatError
from twin.machine.anchor import Anchor

TWO = np.array([0.0, 100.0])


def small() -> CompensationTable:
    corrections = np.zeros((2, 2, 2, 3))
    corrections[0, 0, 1] = [1e-3, -2.5e-3, 0.0]
    corrections[1, 1, 1] = [0.0, 0.0, -12.3456e-3]
    extrapolated = np.zeros((2, 2, 2), dtype=bool)
    extrapolated[1, 0, 1] = True
    anchor = Anchor(np.array([0.0, 50.0, 0.0]), "X", "Z")
    return CompensationTable(TWO, TWO, TWO, corrections, np.array([0.0, 250.0, 0.0]), anchor, extrapolated)


BY_HAND = """x_mm,y_mm,z_mm,dx_um,dy_um,dz_um
0,0,0,0.0000,0.0000,0.0000
0,0,100,1.0000,-2.5000,0.0000
0,100,0,0.0000,0.0000,0.0000
0,100,100,0.0000,0.0000,0.0000
100,0,0,0.0000,0.0000,0.0000
100,0,100,0.0000,0.0000,0.0000
100,100,0,0.0000,0.0000,0.0000
100,100,100,0.0000,0.0000,-12.3456
"""


def test_the_text_is_that_written_by_hand() -> None:
    assert format_table(small()) == BY_HAND


def test_the_side_file_says_what_the_table_is_for() -> None:
    side = json.loads(format_side_file(small()))
    assert side["crc32"] == f"{zlib.crc32(BY_HAND.encode()):08x}"
    assert side["meaning"] == "added to the commanded axis position"
    assert side["grid"] == {"x_mm": [0.0, 100.0], "y_mm": [0.0, 100.0], "z_mm": [0.0, 100.0]}
    assert side["tool_offset_mm"] == [0.0, 250.0, 0.0]
    assert side["anchor"] == {"point_mm": [0.0, 50.0, 0.0], "primary": "X", "secondary": "Z"}
    assert side["extrapolated_nodes"] == [5]


def test_checksum_is_the_common_crc_32() -> None:
    """Check the check value of CRC-32/ISO-HDLC: the nine digits give cbf43926."""
    assert checksum("123456789") == "cbf43926"


def test_read_again_it_is_the_same_table() -> None:
    again = parse_table(format_table(small()), format_side_file(small()), "t.csv", "t.json")
    assert again.corrections == pytest.approx(small().corrections, abs=1e-12)
    assert (again.extrapolated == small().extrapolated).all()
    assert again.anchor.point_mm.tolist() == [0.0, 50.0, 0.0]
    assert (again.anchor.primary, again.anchor.secondary) == ("X", "Z")


def test_a_changed_table_is_refused_by_its_checksum() -> None:
    with pytest.raises(FormatError, match="CRC-32") as caught:
        parse_table(BY_HAND.replace("-2.5000", "-2.5001"), format_side_file(small()), "t.csv", "t.json")
    assert caught.value.where["file"] == "t.csv"


def resealed(old: str, new: str) -> tuple[str, str]:
    """Return a table text changed together with its checksum."""
    assert old in BY_HAND
    text = BY_HAND.replace(old, new, 1)
    side = json.loads(format_side_file(small()))
    return text, json.dumps({**side, "crc32": checksum(text)})


@pytest.mark.parametrize(
    ("old", "new", "words", "row", "column"),
    [
        ("-2.5000", "nan", "not finite", "3", "dy_um"),
        ("-2.5000", "much", "not a number", "3", "dy_um"),
        ("0,100,0,", "0,90,0,", "Y is 90, but the grid has 100", "4", "y_mm"),
        ("dz_um", "dz_mm", "column 'dz_um' is missing", "1", "dz_um"),
        ("100,100,100,0.0000,0.0000,-12.3456\n", "", "7 lines, but the grid has 8", None, None),
        ("-12.3456\n", "-12.3456\n0,0,0,0,0,0\n", "more lines", "10", "x_mm"),
    ],
)
def test_a_mistake_in_the_table_is_named(old: str, new: str, words: str, row: str | None, column: str | None) -> None:
    text, side = resealed(old, new)
    with pytest.raises(FormatError, match=words) as caught:
        parse_table(text, side, "t.csv", "t.json")
    assert (caught.value.where.get("row"), caught.value.where.get("column")) == (row, column)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"crc32": "12"}, "crc32"),
        ({"colour": "red"}, "colour"),
        ({"extrapolated_nodes": [8]}, "node 8 is not in the grid"),
        ({"tool_offset_mm": [0.0, 1.0]}, "tool_offset_mm"),
        ({"anchor": {"point_mm": [0, 0, 0], "primary": "X", "secondary": "X"}}, "two different axes"),
        ({"meaning": "subtracted"}, "meaning"),
    ],
)
def test_a_mistake_in_the_side_file_is_named(change: dict, words: str) -> None:
    side = {**json.loads(format_side_file(small())), **change}
    with pytest.raises(FormatError, match=words) as caught:
        parse_table(BY_HAND, json.dumps(side), "t.csv", "t.json")
    assert caught.value.where["file"] == "t.json"


@pytest.mark.parametrize("text", ["", "{", "[]", '{"crc32": NaN}'])
def test_a_side_file_that_is_no_json_object(text: str) -> None:
    with pytest.raises(FormatError):
        parse_table(BY_HAND, text, "t.csv", "t.json")
