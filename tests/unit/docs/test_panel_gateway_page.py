"""The page that a panel's programmer works from, against the register map in the code."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from agent.service.gateway.access import LOCKED_TICKS
from agent.service.gateway.registers import (
    ABORT_COIL,
    BLOCKS,
    FLAGS,
    MAY,
    PACKML_NUMBERS,
    RESULT_TEXTS,
    STATE_NUMBERS,
    STATUS,
    Command,
    Form,
    Register,
)

PAGE = (Path(__file__).parents[3] / "docs" / "reference" / "panel-gateway.md").read_text(encoding="utf-8")
ROW = re.compile(r"^\| ([\d–]+) \| `(\w+)` \| (\w+(?: \d+)?) \| (.+) \|$", re.MULTILINE)


def row(register: Register) -> tuple[str, str, str, str]:
    span = str(register.address) if register.words == 1 else f"{register.address}–{register.end - 1}"
    form = f"text {2 * register.words}" if register.form is Form.TEXT else register.form.value
    return span, register.name, form, register.meaning


def test_every_register_stands_on_the_page_and_nothing_else():
    assert ROW.findall(PAGE) == [row(register) for block in BLOCKS for register in block]


@pytest.mark.parametrize(
    "line",
    [
        "- `flags`, from bit 0: " + ", ".join(FLAGS) + ".",
        "- `may`, from bit 0: " + ", ".join(MAY) + ".",
        "- `state`: " + ", ".join(f"{number} {state.value}" for state, number in STATE_NUMBERS.items()) + ".",
        "- `command`: " + ", ".join(f"{command.value} {command.name.lower()}" for command in Command) + ".",
        *(f"| {result.value} | {text} |" for result, text in RESULT_TEXTS.items()),
    ],
)
def test_the_lists_of_numbers_are_those_of_the_code(line):
    assert line in PAGE


def test_the_meaning_of_the_coil_stands_at_its_number():
    row = re.search(r"^\| coil \| meaning \|\n\|---\|---\|\n\| (\d+) \| (.+) \|$", PAGE, re.MULTILINE)
    assert row is not None
    number, meaning = row.groups()
    assert int(number) == ABORT_COIL
    assert meaning.startswith("writing 1 aborts the run")


def test_the_numbers_in_the_text_are_those_of_the_code():
    first_request = max(register.end for register in STATUS if register.end <= 125) - 1
    assert f"Registers 0 to {first_request} fit into one request" in PAGE
    assert f"Idle {PACKML_NUMBERS['Idle']}, Execute {PACKML_NUMBERS['Execute']}, Held {PACKML_NUMBERS['Held']}" in PAGE
    assert LOCKED_TICKS == 5
    assert "for five seconds" in PAGE
