"""Texts that a parser could not digest, or only in minutes: every reader refuses them with an error of its tree."""

from __future__ import annotations

import pytest

from twin.errors import FormatError
from twin.formats import toml_reading
from twin.formats.csv_reading import csv_lines, read_rows
from twin.formats.json_reading import read_json
from twin.formats.toml_reading import StrictModel, parse_toml

DIGITS = "1" + "0" * 5000


class Number(StrictModel):
    format: str
    value: int


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"value = {DIGITS}", "not valid TOML"),
        ("value = " + 20_000 * "[", "nested too deeply"),
        ("value = " + 20_000 * "{a=", "nested too deeply"),
        (".".join(29_000 * ["a"]) + " = 1", "more than 32 parts"),
        ("\n\nvalue = {" + " . ".join(33 * ['"a b"']) + " = 1}", "more than 32 parts.*line 3"),
        ("[" + ".".join(34 * ["'a'"]) + "]", "more than 32 parts"),
        ("# " + toml_reading.MAX_TOML_CHARACTERS * "x", "at most 1000000 are read"),
    ],
)
def test_toml_that_no_parser_digests(text: str, message: str) -> None:
    with pytest.raises(FormatError, match=message) as caught:
        parse_toml(text, "volcal.toml")
    assert caught.value.where["file"] == "volcal.toml"


def test_ordinary_keys_and_numbers_are_no_long_keys() -> None:
    text = ".".join(32 * ["a"]) + " = 1\nb = [" + ", ".join(1000 * ["0.125"]) + "]\nc = '" + 20 * "1." + "'\n"
    assert len(parse_toml(text, "volcal.toml")["b"]) == 1000


@pytest.mark.parametrize("text", [f'{{"format": "f", "value": {DIGITS}}}', 200_000 * "[", '{"a": ' * 200_000])
def test_json_that_no_parser_digests(text: str) -> None:
    with pytest.raises(FormatError, match=r"JSON|nested") as caught:
        read_json(text, "estimate.json", Number, format_name="f", remedy="")
    assert caught.value.where["file"] == "estimate.json"


def test_a_quotation_mark_that_is_not_closed_names_its_row() -> None:
    text = 'a,b\n1,2\n1,"2\n' + 100_000 * "1,2\n"
    with pytest.raises(FormatError, match=r"not valid CSV.*field limit") as caught:
        list(read_rows(text, "balls.csv", ("a", "b")))
    assert "quotation marks" in caught.value.hint


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_every_end_of_line_is_read(end: str) -> None:
    text = "\ufeff" + end.join(["a,b", "", '"1,5",2', ""])
    assert list(csv_lines(text, "balls.csv")) == [(1, ["a", "b"]), (2, []), (3, ["1,5", "2"])]
