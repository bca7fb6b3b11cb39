"""Fields of the set-up, as the command line and the page read them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from agent.planning.new_machine.field import Answers, FieldKind, ProposalsOnly
from agent.planning.new_machine.fields import FIELDS, SETUP_FIELDS, STEPS, catalogue
from agent.planning.new_machine.machine_class import MACHINE_CLASSES
from drivers.errors import InputError


def value(**texts: str) -> Any:
    """Value of the first field of `texts`."""
    for name, text in texts.items():
        FIELDS[name].refuse_malformed(text)
    return Answers(texts, ProposalsOnly(), Path())[FIELDS[next(iter(texts))]]


def test_every_field_has_a_name_of_its_own_one_step_and_labels_in_both_languages() -> None:
    assert len(FIELDS) == len(SETUP_FIELDS)
    assert {field.step for field in SETUP_FIELDS} == set(STEPS)
    assert all(set(texts) == {"en", "de"} and all(texts.values()) for texts in catalogue().values())


def test_every_choice_that_is_no_name_of_the_machine_s_own_has_words() -> None:
    bare = {name for name, field in FIELDS.items() if field.kind is FieldKind.CHOICE and None in field.words.values()}
    assert bare == {"spindle", "touches"}


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("name", " Halle 2 ", "Halle 2"),
        ("machine_class", "mill", MACHINE_CLASSES["mill"]),
        ("travel", "800 -20:480 400", ((0.0, 800.0), (-20.0, 480.0), (0.0, 400.0))),
        ("rapid", "1e4 12000 9000.5", (10000.0, 12000.0, 9000.5)),
        ("tilt", "0", 0.0),
        ("tip_diameter", "5", 2.5),
        ("touches", "13", 13),
        ("artefact", "bar.toml", Path("bar.toml")),
    ],
)
def test_a_text_becomes_a_value(name: str, text: str, expected: object) -> None:
    assert value(**{name: text}) == expected


def test_a_number_of_balls_is_checked_against_the_shape() -> None:
    assert value(balls="9", shape="ball-plate") == 9
    with pytest.raises(InputError, match="has no 10 balls"):
        value(balls="10", shape="ball-plate")


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
        FIELDS[name].refuse_malformed(text)
    assert raised.value.where["option"] == FIELDS[name].flag
