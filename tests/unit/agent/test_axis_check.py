"""Check of axes by jogs of a person, and of the probe input by a finger."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.service.setup.axis_check import (
    Direction,
    Finding,
    Jog,
    JogObservation,
    Part,
    ProbeFinding,
    judge_trigger,
)
from twin.machine.kinematic_chain import parse_chain

CHAIN = parse_chain("tool-Z-bed-Y-X-workpiece")


@pytest.mark.parametrize(
    ("asked", "change", "direction", "part", "finding"),
    [
        ("X", (5.0, 0.0, 0.0), Direction.AS_DRAWN, Part.WORKPIECE, Finding.GOOD),
        ("Z", (0.0, 0.01, -20.0), Direction.AS_DRAWN, Part.TOOL, Finding.GOOD),
        ("X", (0.0, 5.0, 0.0), Direction.AS_DRAWN, Part.WORKPIECE, Finding.OTHER_AXIS),
        ("X", (5.0, 4.0, 0.0), Direction.AS_DRAWN, Part.WORKPIECE, Finding.SEVERAL_AXES),
        ("X", (5.0, 0.0, 0.0), Direction.OPPOSITE, Part.WORKPIECE, Finding.WRONG_SIGN),
        ("X", (5.0, 0.0, 0.0), Direction.ACROSS, Part.WORKPIECE, Finding.WRONG_DIRECTION),
        ("X", (5.0, 0.0, 0.0), Direction.AS_DRAWN, Part.TOOL, Finding.WRONG_SIDE),
        ("Z", (0.0, 0.0, 2.0), Direction.AS_DRAWN, Part.WORKPIECE, Finding.WRONG_SIDE),
    ],
)
def test_a_jog_names_a_wrong_letter_sign_or_side(
    asked: str, change: tuple[float, float, float], direction: Direction, part: Part, finding: Finding
) -> None:
    assert JogObservation(Jog(asked, change), direction, part).finding(CHAIN) is finding


def test_nothing_has_moved_below_the_least_jog() -> None:
    assert Jog("X", (0.9, 0.0, 0.0)).moved == ()
    assert Jog("X", (-1.1, 0.0, 0.0)).moved == ("X",)
    assert Jog("X", (-1.1, 0.0, 0.0)).distance_mm == -1.1


@pytest.mark.parametrize(
    ("seen", "finding"),
    [
        ("", ProbeFinding.WAITING),
        ("000", ProbeFinding.WAITING),
        ("0011", ProbeFinding.HELD),
        ("0010", ProbeFinding.GOOD),
        ("1111", ProbeFinding.ALWAYS_ON),
        ("110", ProbeFinding.WAITING),
        ("1101", ProbeFinding.HELD),
        ("11010", ProbeFinding.GOOD),
    ],
)
def test_the_input_must_be_seen_off_on_and_off(seen: str, finding: ProbeFinding) -> None:
    assert judge_trigger([one == "1" for one in seen]) is finding


@given(st.lists(st.booleans()))
def test_an_input_is_good_only_after_it_went_on_and_off(seen: list[bool]) -> None:
    if judge_trigger(seen) is ProbeFinding.GOOD:
        assert not seen[-1]
        assert (False, True) in pairwise(seen)
