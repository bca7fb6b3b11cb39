"""Options of the export formats. Each format declares the options that it reads, and user interfaces offer the declared
options.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

Value = TypeVar("Value")
Triple = tuple[float, float, float]
Names = tuple[str, str, str]


@dataclass(frozen=True)
class WholeNumber:
    """Type of an option whose value is an integer from `minimum` to `maximum`. If `maximum` is None, there is no upper
    limit.
    """

    minimum: int
    maximum: int | None = None


@dataclass(frozen=True)
class PositiveNumber:
    """Type of an option whose value is a number greater than zero."""


@dataclass(frozen=True)
class OneOf:
    """Type of an option whose value is one of the given `words`."""

    words: tuple[str, ...]


@dataclass(frozen=True)
class Switch:
    """Type of an option that is either set (True) or not set (False)."""


@dataclass(frozen=True)
class Text:
    """Type of an option whose value is given as text. `form` shows the form of the text, for example `X,Y,Z`.

    `parse` is a function that converts the text to a value. It raises a ValueError that describes the correct form if
    the text cannot be converted.
    """

    form: str
    parse: Callable[[str], Any]


Domain = WholeNumber | PositiveNumber | OneOf | Switch | Text


@dataclass(frozen=True)
class FormatOption(Generic[Value]):
    """Option of an export format.

    `key` is the name of the option in `ExportOptions`. On a command line, the name is written with hyphens. `default`
    is the value if the option is not set.
    """

    key: str
    domain: Domain
    default: Value
    help: str


@dataclass(frozen=True)
class ExportOptions:
    """Values of export options that the user has set, stored by the key of the option. Indexing with an option returns
    its value, or its default if it is not set.

    If `opposite_sign` is True, every value is written with the opposite of the sign that the manual of the controller
    documents. This is needed if tests show that a controller uses the opposite sign.
    """

    values: Mapping[str, Any] = field(default_factory=dict)
    opposite_sign: bool = False

    def __getitem__(self, option: FormatOption[Value]) -> Value:
        value: Value = self.values.get(option.key, option.default)
        return value

    @property
    def sign(self) -> int:
        return -1 if self.opposite_sign else 1


def _triple(text: str) -> Triple:
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise ValueError("write three positions in mm, such as 0,650,0") from None
    return x, y, z


def _names(text: str) -> Names:
    names = tuple(part.strip() for part in text.split(","))
    if len(set(names)) != 3 or len(names) != 3 or not all(name.isidentifier() for name in names):
        raise ValueError("write three different names of letters and digits for X, Y and Z, such as X1,Y1,Z1")
    return names[0], names[1], names[2]


REFERENCE_MM = FormatOption[Triple | None](
    "reference_mm", Text("X,Y,Z", _triple), None, "Reference point [default: the anchor]."
)
"""Machine position in mm of the reference point; if None, the table's anchor is used."""

AXIS_NAMES = FormatOption[Names | None]("axes", Text("X1,Y1,Z1", _names), None, "Names of X, Y, Z in the controller.")
"""Names of the axes X, Y, Z in the controller; if None, the usual names of the format are used."""
