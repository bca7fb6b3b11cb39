"""Position sets from TOML; CSV is tested together with the artefact file."""

from __future__ import annotations

import pytest

from twin.errors import FormatError
from twin.formats.position_set_file import parse_positions


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
