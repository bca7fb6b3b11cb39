"""Alarm numbers: one for each class of the tree, never two the same, and the document says the same."""

from __future__ import annotations

import re
from pathlib import Path

from agent.errors import Busy, RunError
from agent.service.alarms import CODES, DEFECT, alarm_code, alarm_of
from drivers.errors import InputError, LinkLost, MotionFault, StoreError, UserError, VolcalError

DOCUMENT = Path(__file__).parents[3] / "docs" / "reference" / "alarms.md"


TREE = {VolcalError.__module__, RunError.__module__}
"""Modules that together are the error tree; plugins and the rooms of the agent may add classes of their own."""


def _tree(root: type[VolcalError]) -> set[type[VolcalError]]:
    return {root}.union(*(_tree(child) for child in root.__subclasses__() if child.__module__ in TREE))


def test_the_drivers_know_no_class_that_only_a_run_can_decide():
    of_the_drivers = {kind for kind in _tree(VolcalError) if kind.__module__ == VolcalError.__module__}
    assert of_the_drivers.isdisjoint(_tree(RunError))
    assert len(_tree(RunError)) == 13


def test_every_class_of_the_tree_has_a_number_and_no_number_is_used_twice():
    assert set(CODES) == _tree(VolcalError)
    numbers = [entry.code for entry in (DEFECT, *CODES.values())]
    assert len(set(numbers)) == len(numbers)
    assert all(0 < number < 0x10000 for number in numbers)


def test_numbers_once_given_stay():
    """Panels in the field hold these: a change here is a break of contract."""
    given = {entry.code: kind.__name__ for kind, entry in CODES.items()}
    assert given[311] == "LinkLost"
    assert given[350] == "PermissionMissing"
    assert given[362] == "ReadBackMismatch"
    assert given[460] == "Busy"
    assert given[470] == "Aborted"
    assert DEFECT.code == 900


def test_the_document_lists_the_same_numbers_texts_and_hints():
    rows = re.findall(
        r"^\| (\d+) \| ([\w ]+) \| (.+?) \| (.+?) \|$", DOCUMENT.read_text(encoding="utf-8"), re.MULTILINE
    )
    expected = [(str(entry.code), kind.__name__, entry.text, entry.hint) for kind, entry in CODES.items()]
    expected.append((str(DEFECT.code), "any other", DEFECT.text, DEFECT.hint))
    assert rows == expected


def test_only_an_error_of_a_file_says_to_correct_a_file():
    assert alarm_of(InputError("a", file="balls.csv")).hint == CODES[InputError].hint
    assert alarm_of(InputError("there is no kind of run 'polish'")).hint == CODES[UserError].hint
    assert alarm_of(InputError("there is no kind of run 'polish'")).code == 202


def test_an_alarm_keeps_the_words_and_places_of_its_error():
    alarm = alarm_of(LinkLost("no answer from 10.0.0.7", hint="plug it in", device="cnc").at(step="station-1/ball-02"))
    assert (alarm.code, alarm.text, alarm.hint) == (311, "no answer from 10.0.0.7", "plug it in")
    assert dict(alarm.where) == {"device": "cnc", "step": "station-1/ball-02"}


def test_an_error_without_a_hint_gets_that_of_the_table():
    assert alarm_of(Busy("run 7 is under way")).hint == CODES[Busy].hint


def test_a_plugins_own_error_has_the_number_of_the_nearest_class_above():
    class ServoFault(MotionFault):
        pass

    assert alarm_code(ServoFault("axis X")).code == CODES[MotionFault].code
    assert alarm_code(StoreError("x")).code == 360


def test_what_is_no_error_of_the_tree_is_a_defect_whose_text_is_in_the_log_alone():
    alarm = alarm_of(ZeroDivisionError("division by zero"))
    assert alarm.code == DEFECT.code
    assert "ZeroDivisionError" not in alarm.text
    assert "division" not in alarm.text
