"""Keys of the content of frozen values, and values of equal content that are one object."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import pytest

from twin.arrays import Array
from twin.immutable import SharedValues, content_key


@dataclass(frozen=True, eq=False)
class Part:
    name: str
    at: Array
    places: Mapping[int, Array] = field(default_factory=dict)
    found: list[int] = field(default_factory=list, init=False)


def part(name: str = "bar", x: float = 1.0, place: float = 2.0) -> Part:
    return Part(name, np.array([x, 0.0]), {1: np.array([place])})


def test_equal_content_has_one_key_whatever_has_been_computed_from_it() -> None:
    one, other = part(), part()
    other.found.append(1)
    assert content_key(one) == content_key(other)
    assert hash(content_key(one)) == hash(content_key(other))


@pytest.mark.parametrize(
    "other", [part(name="plate"), part(x=np.nextafter(1.0, 2.0)), part(place=3.0), Part("bar", np.array([[1.0, 0.0]]))]
)
def test_another_content_has_another_key(other: Part) -> None:
    assert content_key(part()) != content_key(other)


def test_a_class_is_part_of_the_content() -> None:
    @dataclass(frozen=True)
    class Point:
        x: float

    @dataclass(frozen=True)
    class Length:
        x: float

    assert content_key(Point(1.0)) != content_key(Length(1.0))


def test_the_first_of_equal_values_is_kept_until_too_many_others_were_used() -> None:
    values: SharedValues[Part] = SharedValues(2)
    first, second = part("first"), part("second")
    assert values.shared(first) is first
    assert values.shared(second) is second
    assert values.shared(part("first")) is first
    values.shared(part("third"))
    assert values.shared(part("first")) is first
    assert values.shared(part("second")) is not second
