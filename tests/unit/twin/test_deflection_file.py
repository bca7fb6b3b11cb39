from pathlib import Path

import numpy as np
import pytest

from twin.errors import FormatError
from twin.formats.deflection_file import format_deflection, parse_deflection
from twin.machine.deflection import CASE_STUDY_NODES, cantilever_deflection

SHIPPED = Path(__file__).parents[3] / "config" / "machines" / "case-study-deflection.csv"
HEADER = "x_mm,y_mm,z_mm,ux_um,uy_um,uz_um"
ROWS = [f"{x},{y},{z},{x + 1},{y},{-z}" for x in (0, 10) for y in (0, 5) for z in (0, 2)]


def text_of(rows, header=HEADER):
    return "\n".join((header, *rows)) + "\n"


def test_reads_micrometres_as_millimetres():
    grid = parse_deflection(text_of(ROWS), "d.csv")
    np.testing.assert_array_equal(grid.x, [0.0, 10.0])
    np.testing.assert_allclose(grid.at([10.0, 5.0, 2.0]), [[11e-3, 5e-3, -2e-3]])


def test_rows_columns_line_ends_and_blanks_as_an_export_may_have_them():
    expected = parse_deflection(text_of(ROWS), "d.csv").values
    shuffled = text_of([ROWS[k] for k in (3, 1, 7, 0, 6, 2, 5, 4)]).replace("\n", "\r\n") + "\r\n \r\n"
    np.testing.assert_array_equal(parse_deflection("\ufeff" + shuffled, "d.csv").values, expected)
    turned = [",".join(row.split(",")[k] for k in (5, 0, 1, 2, 3, 4)) for row in ROWS]
    header = " uz_um, x_mm,y_mm,z_mm,ux_um,uy_um"
    np.testing.assert_array_equal(parse_deflection(text_of(turned, header), "d.csv").values, expected)


def test_coordinates_that_differ_in_their_last_digits_are_one_node():
    rows = [*ROWS[:-1], ROWS[-1].replace("10,5,2,", "10.0000000001,4.9999999999,2,")]
    assert parse_deflection(text_of(rows), "d.csv").values.shape == (2, 2, 2, 3)


@pytest.mark.parametrize(
    ("text", "where", "says"),
    [
        ("", {"row": "1"}, "column 'x_mm' is missing"),
        (text_of(ROWS, HEADER.replace("uy_um", "uy")), {"row": "1"}, "column 'uy_um' is missing"),
        (text_of(ROWS, HEADER + ",extra"), {"row": "1"}, "unknown column 'extra'"),
        (text_of(ROWS, HEADER + ",x_mm"), {"row": "1"}, "column 'x_mm' appears more than once"),
        (text_of([]), {}, "no node"),
        (text_of([*ROWS[:2], "0,5,0,1,nan,2", *ROWS[3:]]), {"row": "4", "column": "uy_um"}, "not finite"),
        (text_of([*ROWS[:2], "0,5,0,1,?,2", *ROWS[3:]]), {"row": "4", "column": "uy_um"}, "'?' is not a number"),
        (text_of([*ROWS[:2], "0,5,0,1,2", *ROWS[3:]]), {"row": "4"}, "5 values, but the header names 6 columns"),
        (text_of([*ROWS, ROWS[3]]), {"row": "10"}, "the node of row 5 is repeated"),
        (text_of([*ROWS[:5], *ROWS[6:]]), {}, "1 of 8 nodes of the 2 x 2 x 2 grid are missing, the first at X 10"),
        (text_of(ROWS[:4]), {"axis": "X"}, "at least two nodes"),
    ],
)
def test_each_mistake_has_its_place(text, where, says):
    with pytest.raises(FormatError) as caught:
        parse_deflection(text, "d.csv")
    assert caught.value.where == {"file": "d.csv"} | where
    assert says in str(caught.value)


def test_round_trip():
    grid = cantilever_deflection(*CASE_STUDY_NODES)
    again = parse_deflection(format_deflection(grid), "d.csv")
    for mine, theirs in zip(grid.nodes, again.nodes, strict=True):
        np.testing.assert_allclose(mine, theirs, atol=1e-6)
    assert np.abs(grid.values - again.values).max() <= 0.5001e-7


def test_the_shipped_grid_is_what_the_generator_makes():
    shipped = SHIPPED.read_bytes()
    assert format_deflection(cantilever_deflection(*CASE_STUDY_NODES)).encode() == shipped
    assert parse_deflection(shipped.decode(), SHIPPED.name).values.shape == (9, 15, 13, 3)
