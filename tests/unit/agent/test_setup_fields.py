"""Fields of the set-up, as the command line and the page read them."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import pytest

from agent.runs.new_machine.answers import InitOptions
from agent.runs.new_machine.fields import SETUP_FIELDS, STEPS, read_options
from drivers.errors import InputError

BY_NAME = {field.name: field for field in SETUP_FIELDS}


def test_every_option_is_a_field_of_one_step() -> None:
    assert sorted(BY_NAME) == sorted(field.name for field in fields(InitOptions))
    assert {field.step for field in SETUP_FIELDS} == set(STEPS)


@pytest.mark.parametrize(
    ("name", "text", "value"),
    [
        ("name", " Halle 2 ", "Halle 2"),
        ("machine_class", "mill", "mill"),
        ("travel", "800 -20:480 400", ("800", "-20:480", "400")),
        ("rapid", "1e4 12000 9000.5", (10000.0, 12000.0, 9000.5)),
        ("balls", "9", 9),
        ("tilt", "0", 0.0),
        ("touches", "13", 13),
        ("artefact", "bar.toml", Path("bar.toml")),
    ],
)
def test_a_text_becomes_the_value_of_the_option(name: str, text: str, value: object) -> None:
    assert getattr(read_options({name: text}), name) == value


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("machine_class", "lathe", "one of mill"),
        ("travel", "800 500", "three travels"),
        ("rapid", "1 2", "three numbers"),
        ("rapid", "1 2 nan", "three numbers"),
        ("stylus", "inf", "a number"),
        ("stylus", "1,5", "a number"),
        ("balls", "9.5", "a whole number from 2 to 99"),
        ("balls", "100", "a whole number from 2 to 99"),
        ("tilt", "61", "a number from 0 to 60"),
        ("touches", "7", "one of 5, 9, 13, 25"),
        ("name", "a\nb", "one line"),
        ("name", "x" * 401, "one line"),
    ],
)
def test_a_text_that_is_no_value_is_refused_with_the_name_of_its_option(name: str, text: str, words: str) -> None:
    with pytest.raises(InputError, match=words) as raised:
        read_options({name: text})
    assert raised.value.where["option"] == BY_NAME[name].flag
