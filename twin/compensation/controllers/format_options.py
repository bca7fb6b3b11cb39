"""Options of the export formats: each format declares the options it reads, and a user interface offers these."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

Value = TypeVar("Value")
Triple = tuple[float, float, float]
Names = tuple[str, str, str]


@dataclass(frozen=True)
class WholeNumber:
    """Option values that are integers from `minimum` to `maximum`; if `maximum` is None, there is no upper bound."""

    minimum: int
    maximum: int | None = None


@dataclass(frozen=True)
class PositiveNumber:
    """Option values that are numbers greater than zero."""


@dataclass(frozen=True)
class OneOf:
    """Option values that are one of a few words."""

    words: tuple[str, ...]


@dataclass(frozen=True)
class Switch:
    """Option that is True if it is set."""


@dataclass(frozen=True)
class Text:
    """Option values given as text of the form `form`, for example `X,Y,Z`.

    `parse` returns the value of a text; its ValueError describes the correct form.
    """

    form: str
    parse: Callable[[str], Any]


Domain = WholeNumber | PositiveNumber | OneOf | Switch | Text


@dataclass(frozen=True)
class FormatOption(Generic[Value]):
    """Option of an export format.

    `key` is its name in `ExportOptions` and, with hyphens, on a command line; `default` applies if the option is not
    set.
    """

    key: str
    domain: Domain
    default: Value
    help: str


@dataclass(frozen=True)
class ExportOptions:
    """Values set by the user, by option key; indexing with an option returns its value or its default.

    `opposite_sign`: write every value with the opposite of the documented sign, for a controller that was found to use
    the opposite sign.
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
