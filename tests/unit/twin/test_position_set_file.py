"""Position sets from TOML; CSV is tested together with the artefact file."""

from __future__ import annotations

import pytest

from twin.errors import FormatError
from twin.formats.position_set_file import format_positions, parse_positions


def test_toml_says_the_same_as_csv() -> None:
    toml = "[[positions]]\nstation = 2\nazimuth_deg = 45\nelevation_deg = -30.5\n"
    assert parse_positions(toml, "set.toml") == parse_positions(
        "station,azimuth_deg,elevation_deg\n2,45,-30.5\n", "set.csv"
    )


def test_toml_names_file_and_key_of_a_mistake() -> None:
    wrong = "[[positions]]\nstation = 2\nazimuth_deg = 245\nelevation_deg = 0\n"
    with pytest.raises(FormatError, match=r"outside ±180.*set\.toml.*positions\[0\]"):
        parse_positions(wrong, "set.toml")
    with pytest.raises(FormatError, match="unknown key 'azimut_deg'"):
        parse_positions(wrong.replace("azimuth_deg", "azimut_deg"), "set.toml")


def test_the_balls_of_a_position_are_read_and_written() -> None:
    text = "station,azimuth_deg,elevation_deg,tool,balls\n1,0,45,,0 3 10\n2,90,-45,long,\n"
    first, second = parse_positions(text, "set.csv")
    assert (first.balls, first.tool, second.balls, second.tool) == ((0, 3, 10), None, None, "long")
    assert format_positions([first, second]) == text
    toml = "[[positions]]\nstation = 1\nazimuth_deg = 0\nelevation_deg = 45\nballs = [0, 3, 10]\n"
    assert [one.balls for one in parse_positions(toml, "set.toml")] == [(0, 3, 10)]


@pytest.mark.parametrize(
    ("balls", "words"),
    [
        ("0 1", "the balls 0 1 are not at least 3 different numbers"),
        ("0 5 3", "in rising order"),
        ("0 3 3", "in rising order"),
        ("0 3 x", "'0 3 x' are not numbers of balls"),
        ("0 3 -5", "are not numbers of balls"),
        ("0 3 ²", "are not numbers of balls"),
        ("0 3 " + 5000 * "9", "are not numbers of balls"),
    ],
)
def test_balls_that_are_none_are_named_with_their_row(balls: str, words: str) -> None:
    with pytest.raises(FormatError, match=words) as refused:
        parse_positions(f"station,azimuth_deg,elevation_deg,balls\n1,0,45,{balls}\n", "set.csv")
    assert (refused.value.where["file"], refused.value.where["row"]) == ("set.csv", "2")


def test_an_orientation_with_other_balls_is_the_same_position() -> None:
    with pytest.raises(FormatError, match="already listed as number 1"):
        parse_positions("station,azimuth_deg,elevation_deg,balls\n1,0,45,0 1 2\n1,0,45,3 4 5\n", "set.csv")


@pytest.mark.parametrize(
    "row",
    [
        "1,22,5,45,0",  # 22,5 and 45,0 with decimal commas
        "1,0,45,,0 1 2,3",
    ],
)
def test_more_values_than_columns_are_refused(row: str) -> None:
    columns = "station,azimuth_deg,elevation_deg" + (",tool,balls" if " " in row else "")
    with pytest.raises(FormatError, match=r"values, but the header names . columns") as refused:
        parse_positions(f"{columns}\n1,0,45\n{row}\n", "set.csv")
    assert (refused.value.where["file"], refused.value.where["row"]) == ("set.csv", "3")


def test_empty_cells_behind_the_columns_are_nothing() -> None:
    (position,) = parse_positions("station,azimuth_deg,elevation_deg\n1,0,45,, \n", "set.csv")
    assert (position.azimuth_deg, position.elevation_deg) == (0.0, 45.0)
