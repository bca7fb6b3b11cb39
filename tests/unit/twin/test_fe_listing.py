"""ANSYS listings and CSV results, written here in the form in which PRNSOL prints them."""

from __future__ import annotations

import pytest

from twin.errors import FormatError
from twin.finite_elements.listing import is_listing, parse_listing
from twin.finite_elements.result_tables import (
    parse_positions_of_results,
    parse_results_at_positions,
    parse_results_by_step,
)

HEAD = """ PRINT {title}  NODAL SOLUTION PER NODE

  ***** POST1 NODAL DEGREE OF FREEDOM LISTING *****

  LOAD STEP={step:6d}  SUBSTEP={substep:6d}
   TIME=    1.0000      LOAD CASE=   0

  THE FOLLOWING DEGREE OF FREEDOM RESULTS ARE IN {frame} COORDINATE SYSTEM{number}

    NODE{columns}
"""


def listing(rows, step=1, columns=("UX", "UY", "UZ", "USUM"), substep=1, frame="THE GLOBAL", number=""):
    """Return one page: each row is a node with its numbers, without blanks between negative ones."""
    names = "".join(f"{name:>10}   " for name in columns)
    head = HEAD.format(title="U  ", step=step, substep=substep, frame=frame, number=number, columns=names)
    lines = [f"{node:8d} " + "".join(f"{value:12.5E}" for value in values) for node, *values in rows]
    return head + "\n".join(lines) + "\n\n MAXIMUM ABSOLUTE VALUES\n NODE          1            1\n VALUE   0.1 0.2\n\n"


def summed(node, x, y, z):
    """Return a row with the sum that PRNSOL adds: the length of the vector."""
    return (node, x, y, z, (x * x + y * y + z * z) ** 0.5)


def test_pages_load_steps_and_numbers_without_blanks() -> None:
    text = listing([summed(1, 1e-3, -2e-3, -3e-3)]) + listing([summed(77, -1.5e-3, -2.5e-3, -3.5e-3)])
    text += listing([summed(77, 5e-3, 6e-3, 7e-3)], step=12)
    assert "E-03-2" in text  # numbers run together
    results = parse_listing(text, "r.lis")
    assert results.at(1, 1).displacement == (1e-3, -2e-3, -3e-3)
    assert results.at(1, 77).displacement == (-1.5e-3, -2.5e-3, -3.5e-3)
    assert results.at(12, None).displacement == (5e-3, 6e-3, 7e-3)
    assert results.at(12, None).rotation is None
    assert is_listing(text)
    assert not is_listing("load_step,ux,uy,uz\n1,1,2,3\n")


def test_the_sum_is_compared_as_precisely_as_it_is_listed() -> None:
    text = listing(ROW).replace("1.00000E-03 2.00000E-03 3.00000E-03 3.74166E-03", "0.0010 0.0020 0.0030 0.0038")
    assert parse_listing(text, "r.lis").at(1, 1).displacement == (1e-3, 2e-3, 3e-3)
    with pytest.raises(FormatError, match="USUM"):
        parse_listing(text.replace("0.0038", "0.0042"), "r.lis")


def test_components_and_rotations_in_listings_of_their_own() -> None:
    text = "".join(listing([(5, value)], columns=(name,)) for name, value in (("UX", 1.0), ("UY", 2.0), ("UZ", 3.0)))
    text += listing([summed(5, 1e-5, 2e-5, 3e-5)], columns=("ROTX", "ROTY", "ROTZ", "RSUM"))
    result = parse_listing(text, "r.lis").at(1, 5)
    assert result.displacement == (1.0, 2.0, 3.0)
    assert result.rotation == (1e-5, 2e-5, 3e-5)


ROW = [summed(1, 1e-3, 2e-3, 3e-3)]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "no nodal displacement"),
        (listing(ROW, frame="THE NODAL"), "not in the global frame"),
        (listing(ROW, frame="", number=" 12"), "not in the global frame"),
        (listing(ROW) + listing(ROW, substep=2), "substeps 1 and 2"),
        (listing(ROW) + listing(ROW), "listed a second time"),
        (listing(ROW).replace("2.00000E-03", "        NaN"), "not a node with numbers"),
        (listing(ROW).replace("2.00000E-03", "***********"), "not a node with numbers"),
        (listing(ROW).replace("1.00000E-03 2", "1.00000E-030.2"), "'1  1.00000E-030.2"),
        (listing(ROW).replace("1.00000E-03 2.00000E-03", "1.2345678.901"), "not a node with numbers"),
        (listing(ROW).replace("1.00000E-03", "1.00000E-3"), "not a node with numbers"),
        (listing(ROW).replace("1.00000E-03", "1.00000E-0\u0663"), "not a node with numbers"),
        (listing(ROW).replace("1.00000E-03", "1.00000E-31"), "USUM is 0.00374166, but UX, UY, UZ give 0.00360555"),
        (listing(ROW, columns=("UX", "UY", "UZ", "UX")), "UX appears more than once"),
        (listing(ROW, frame="THE GLOBAL CYLINDRICAL"), "not in the global frame"),
        (listing(ROW).replace("2.00000E-03", "           ", 1), "3 numbers for the 4 columns"),
        (listing(ROW).replace("2.00000E-03", "2.0000E+999"), "not finite"),
        (listing([(1, 1e-3)], columns=("UX",)), "UY, UZ of node 1"),
        (listing(ROW) + listing([(1, 1e-5)], columns=("ROTX",)), "ROTY, ROTZ of node 1"),
    ],
)
def test_mistakes_in_a_listing(text: str, says: str) -> None:
    with pytest.raises(FormatError, match=says) as caught:
        parse_listing(text, "r.lis")
    assert caught.value.where["file"] == "r.lis"


@pytest.mark.parametrize(
    ("step", "node", "says"), [(2, 1, "load step 2 is not"), (1, None, "lists 2 nodes"), (1, 9, "node 9 is not listed")]
)
def test_a_result_that_is_not_there(step: int, node: int | None, says: str) -> None:
    results = parse_listing(listing([*ROW, summed(2, 1.0, 1.0, 1.0)]), "r.lis")
    with pytest.raises(FormatError, match=says):
        results.at(step, node)


def test_tables() -> None:
    positions = parse_positions_of_results("x_mm,y_mm,z_mm,load_step,file\n0,1,2,7,a.lis\n0,1,3,,\n", "p.csv")
    assert [(one.axes_mm, one.load_step, one.file, one.probe) for one in positions] == [
        ((0.0, 1.0, 2.0), 7, "a.lis", None),
        ((0.0, 1.0, 3.0), None, None, None),
    ]
    steps = parse_results_by_step("load_step,ux,uy,uz,rotx,roty,rotz\n3,1,2,3,4,5,6\n", "r.csv")
    assert steps.at(3, None).rotation == (4.0, 5.0, 6.0)
    both, results = parse_results_at_positions("x_mm,y_mm,z_mm,ux,uy,uz\n9,8,7,1,2,3\n", "r.csv")
    assert (both[0].axes_mm, results.at(1, None).displacement) == ((9.0, 8.0, 7.0), (1.0, 2.0, 3.0))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("load_step,ux,uy,uz\n1,nan,2,3\n", "not finite"),
        ("load_step,ux,uy,uz\n1,1,2,3\n1,1,2,3\n", "second result"),
        ("load_step,ux,uy,uz,rotx\n1,1,2,3,4\n", "the cell is empty"),
        ("load_step,ux,uy,uz\n", "no result follows"),
    ],
)
def test_mistakes_in_a_table(text: str, says: str) -> None:
    with pytest.raises(FormatError, match=says):
        parse_results_by_step(text, "r.csv")
