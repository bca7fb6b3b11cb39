"""What a format is given and what it gives back."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal, Protocol

from twin.arrays import Array
from twin.compensation.table import CompensationTable
from twin.machine.error_model import ErrorModel

Correction = Callable[[Array], Array]
"""Axis positions (n, 3) mm to what the controller adds to them (n, 3) mm."""

Names = tuple[str, str, str]
Facts = Mapping[str, str | int | float]


@dataclass(frozen=True, eq=False)
class TableEstimate:
    """The estimate that a table was built from: `parameters` (p,) and their `covariance` (p, p)."""

    model: ErrorModel
    parameters: Array
    covariance: Array


@dataclass(frozen=True, eq=False)
class ExportSource:
    """A table, and its estimate where there is one."""

    table: CompensationTable
    estimate: TableEstimate | None = None


@dataclass(frozen=True)
class ExportOptions:
    """What the controller on the spot wants; each format uses those that it knows.

    `reference_mm`: machine position of the reference point, the table's anchor where None. `axis_names`: as the
    controller calls X, Y, Z, the format's usual names where None. `opposite_sign`: write every value with the other
    sign than documented, for a controller that was found to count the other way.
    """

    reference_mm: tuple[float, float, float] | None = None
    axis_names: Names | None = None
    opposite_sign: bool = False
    encoder: int = 0
    first_table: int = 0
    most_tables: int = 62
    products: bool = True
    detection_unit_um: float = 1.0
    magnification: int | None = None
    bank: Literal["A", "B"] = "A"

    @property
    def sign(self) -> int:
        return -1 if self.opposite_sign else 1

    def names(self, usual: Names) -> Names:
        return self.axis_names or usual


@dataclass(frozen=True, eq=False)
class ControllerExport:
    """`files`: name to text. `correction`: what they make the controller add, rounded as they are, whichever sign the
    controller wants. `losses`: what the format cannot say, in words. `facts`: figures that have to be set by hand."""

    files: Mapping[str, str]
    correction: Correction
    losses: tuple[str, ...]
    facts: Facts = field(default_factory=dict)


class FormatWriter(Protocol):
    def __call__(self, source: ExportSource, choices: ExportOptions) -> ControllerExport:
        """Raises DataError for what the format cannot take, with the reason and what to do."""
        ...
