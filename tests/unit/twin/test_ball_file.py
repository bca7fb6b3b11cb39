"""Ball files: their meaning, and the reported location of mistakes."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from measured_set import TOOL, bar, measured

from twin.artefact.position_set import Position, parse_position_set
from twin.errors import FormatError
from twin.formats.ball_file import format_balls, parse_balls

TOOLS = {"probe": (0.0, 250.0, 0.0), "long": (0.0, 400.0, 0.0)}
HEADER = "position,station,azimuth_deg,elevation_deg,tool,ball,x_mm,y_mm,z_mm,sigma_um,temperature_c"
GOOD = f"""{HEADER}
7,1,45,0,probe,0,100.5,200.25,300.125,1.5,20.5
7,1,45,0,probe,1,101,201,301,,20.25
9,2,0,-45,long,0,102,202,302,2,21

"""


def test_a_file_is_read_as_it_is_written() -> None:
    read = parse_balls(GOOD, "balls.csv", TOOLS)
    seen = read.observations
    assert seen.position.tolist() == [0, 0, 1]
    assert read.positions == (Position(1, 45.0, 0.0), Position(2, 0.0, -45.0))
    assert seen.tool.tolist() == [0, 0, 1]
    assert seen.ball.tolist() == [0, 1, 0]
    assert seen.axis_positions[0].tolist() == [100.5, 200.25, 300.125]
    assert np.sqrt(np.diagonal(seen.covariance[0])) == pytest.approx(1.5e-3)
    assert np.sqrt(np.diagonal(seen.covariance[1])) == pytest.approx(1.0e-3)
    assert seen.temperature_c.tolist() == [20.5, 20.25, 21.0]
    assert read.temperature_was_read
    assert seen.elevation_rad == pytest.approx([0.0, 0.0, -np.pi / 4])
    assert seen.tool_offsets.tolist() == [[0.0, 250.0, 0.0], [0.0, 400.0, 0.0]]


def test_columns_may_stand_in_any_order_and_a_byte_order_mark_is_passed_over() -> None:
    lines = [line.split(",")[::-1] for line in GOOD.strip().splitlines()]
    turned = "\ufeff" + "\r\n".join(",".join(cells) for cells in lines)
    assert parse_balls(turned, "b", TOOLS).observations.axis_positions[2].tolist() == [102.0, 202.0, 302.0]


def test_written_and_read_again_nothing_is_lost() -> None:
    seen = measured("S3", 2, bar(), lambda X, t: np.zeros_like(X), np.random.default_rng(3), temperature_c=21.25)
    seen = dataclasses.replace(seen, covariance=seen.covariance * np.linspace(1, 4, seen.size)[:, None, None])
    positions = parse_position_set("S3", 2)
    again = parse_balls(format_balls(seen, positions, ["probe"]), "b", {"probe": TOOL})
    assert again.positions == positions
    assert again.observations.axis_positions == pytest.approx(seen.axis_positions, abs=1e-7)
    assert again.observations.covariance == pytest.approx(seen.covariance, rel=1e-5)
    assert again.observations.ball.tolist() == seen.ball.tolist()
    assert again.observations.elevation_rad == pytest.approx(seen.elevation_rad)


def test_temperatures_that_were_not_read_are_not_written_either() -> None:
    text = GOOD.replace(",20.5\n", ",\n").replace(",20.25\n", ",\n").replace(",21\n", ",\n")
    read = parse_balls(text, "balls.csv", TOOLS)
    assert not read.temperature_was_read
    assert read.observations.temperature_c.tolist() == [20.0, 20.0, 20.0]
    written = format_balls(read.observations, read.positions, list(TOOLS), read.temperature_was_read)
    assert [line.rpartition(",")[2] for line in written.splitlines()[1:]] == ["", "", ""]
    assert not parse_balls(written, "balls.csv", TOOLS).temperature_was_read


def changed(old: str, new: str) -> str:
    assert old in GOOD
    return GOOD.replace(old, new, 1)


@pytest.mark.parametrize(
    ("text", "words", "row", "column"),
    [
        (changed("y_mm,", ""), "column 'y_mm' is missing", "1", "y_mm"),
        (changed("tool,ball", "ball,ball"), "column 'tool' is missing", "1", "tool"),
        (changed("temperature_c", "temperature_k"), "column 'temperature_c' is missing", "1", "temperature_c"),
        (changed("100.5", "nan"), "'nan' is not finite", "2", "x_mm"),
        (changed("100.5", "1,00.5"), "12 values, but the header names 11 columns", "2", None),
        (changed("100.5", ""), "empty", "2", "x_mm"),
        (changed("200.25", "twelve"), "'twelve' is not a number", "2", "y_mm"),
        (changed("probe,1", "stick,1"), "unknown tool 'stick'", "3", "tool"),
        (changed("probe,1", "probe,1.0"), "'1.0' is not a whole number", "3", "ball"),
        (changed("probe,1", "probe,-1"), "-1 is less than 0", "3", "ball"),
        (changed("probe,1", f"probe,{10**400}"), "0' is larger than 2147483647", "3", "ball"),
        (changed("probe,1", "probe,0"), "already given in row 2", "3", "ball"),
        (changed("1.5,20.5", "-1.5,20.5"), "must be positive", "2", "sigma_um"),
        (changed("1.5,20.5", "0,20.5"), "must be positive", "2", "sigma_um"),
        (changed(",,20.25", ",,"), "temperature of position 7 is empty, while row 2 gives one", "3", "temperature_c"),
        (
            changed("302,2,21", "302,2,"),
            "temperature of position 9 is empty, while row 2 gives one",
            "4",
            "temperature_c",
        ),
        (changed("302,2,21", "302,2,warm"), "'warm' is not a number", "4", "temperature_c"),
        (changed("9,2,0", "9,0,0"), "0 is less than 1", "4", "station"),
        (changed("9,2,0,-45", "9,2,0,-95"), "outside", "4", "azimuth_deg"),
        (
            changed("7,1,45,0,probe,1", "7,1,46,0,probe,1"),
            "azimuth_deg of position 7 differs from that in row 2",
            "3",
            "azimuth_deg",
        ),
        (HEADER + "\n", "no ball follows", None, None),
        ("", "column 'position' is missing", "1", "position"),
    ],
)
def test_a_mistake_is_named_with_its_place(text: str, words: str, row: str | None, column: str | None) -> None:
    with pytest.raises(FormatError, match=words) as caught:
        parse_balls(text, "balls.csv", TOOLS)
    where = caught.value.where
    assert where["file"] == "balls.csv"
    assert (where.get("row"), where.get("column")) == (row, column)
