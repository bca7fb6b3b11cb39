"""Problems of single boxes on the set-up page. A field of the command line has one text; on the page it may have three
or six boxes, and the words there name a box as it is labelled."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from agent.planning.new_machine.field import FieldKind, SetupField
from agent.planning.new_machine.machine_setup import LONGEST_TRAVEL_MM, SHORTEST_TRAVEL_MM
from twin.errors import DataError
from twin.machine.kinematic_chain import AXES

LOWEST, HIGHEST = "lowest", "highest"
NOT_FILLED = "?"
"""Text of a box that is empty beside one that is not."""


@dataclass(frozen=True)
class BoxProblem:
    """Problem of one box: `box` is empty for a field with a single one, X for an axis of a triple, and X-lowest for an
    end of a travel. `word` is the key of its words on the page, which show `values`."""

    box: str
    word: str
    values: dict[str, str] = field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        return {"box": self.box, "word": self.word, "values": self.values}


def box_problems(stated: SetupField[Any], text: str) -> list[BoxProblem]:
    """Return the problems of the boxes that together have `text`. The list is empty if each box alone is good."""
    match stated.kind:
        case FieldKind.TRAVELS:
            return list(_of_travels(text))
        case FieldKind.TRIPLE:
            parts = zip(AXES, text.split(), strict=False)
            return [one for axis, part in parts for one in _of_number(axis, part, stated)] or _not_positive(
                stated, text
            )
        case FieldKind.NUMBER | FieldKind.INTEGER:
            return list(_of_number("", text.strip(), stated)) or _not_positive(stated, text)
        case _:
            return []


def _of_travels(text: str) -> Iterator[BoxProblem]:
    for axis, part in zip(AXES, text.split(), strict=False):
        low, separator, high = part.partition(":")
        ends = {LOWEST: low, HIGHEST: high} if separator else {LOWEST: "0", HIGHEST: low}
        bad = [one for end, value in ends.items() for one in _unreadable(f"{axis}-{end}", value)]
        yield from bad
        if bad:
            continue
        length = float(ends[HIGHEST]) - float(ends[LOWEST])
        for end in ends:
            if length <= 0.0:
                yield BoxProblem(f"{axis}-{end}", "order", {"low": ends[LOWEST], "high": ends[HIGHEST]})
            elif not SHORTEST_TRAVEL_MM <= length <= LONGEST_TRAVEL_MM:
                limits = {"low": f"{SHORTEST_TRAVEL_MM:g}", "high": f"{LONGEST_TRAVEL_MM:g}"}
                yield BoxProblem(f"{axis}-{end}", "length", {"length": f"{length:g}", **limits})


def _of_number(box: str, text: str, stated: SetupField[Any]) -> Iterator[BoxProblem]:
    unreadable = list(_unreadable(box, text))
    yield from unreadable
    if unreadable:
        return
    value, low, high = float(text), stated.lowest, stated.highest
    if stated.kind is FieldKind.INTEGER and not value.is_integer():
        yield BoxProblem(box, "whole", {"text": text})
    elif not low <= value <= high:
        bounds = {"low": f"{low:g}", "high": f"{high:g}"} if math.isfinite(high) else {"low": f"{low:g}"}
        yield BoxProblem(box, "between" if math.isfinite(high) else "least", {"text": text, **bounds})


def _unreadable(box: str, text: str) -> Iterator[BoxProblem]:
    if text == NOT_FILLED:
        yield BoxProblem(box, "empty")
        return
    try:
        readable = math.isfinite(float(text))
    except ValueError:
        readable = False
    if not readable:
        yield BoxProblem(box, "number", {"text": text})


def _not_positive(stated: SetupField[Any], text: str) -> list[BoxProblem]:
    """Return the boxes whose numbers are not above 0 if the field needs positive ones."""
    try:
        stated.meaning(text)
    except DataError:
        parts = text.split()
        boxes = AXES if stated.kind is FieldKind.TRIPLE else ("",)
        return [BoxProblem(box, "positive") for box, part in zip(boxes, parts, strict=False) if float(part) <= 0.0]
    except ValueError:
        return []
    return []
