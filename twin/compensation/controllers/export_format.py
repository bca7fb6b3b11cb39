"""Input and output of the formats of controllers, and the format itself."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from twin.arrays import Array
from twin.compensation.controllers.format_options import ExportOptions, FormatOption
from twin.compensation.table import CompensationTable
from twin.machine.error_model import ErrorModel

Correction = Callable[[Array], Array]
"""Function from axis positions (n, 3) in mm to the corrections that the controller adds to them, (n, 3) in mm."""

Facts = Mapping[str, str | int | float]


@dataclass(frozen=True, eq=False)
class TableEstimate:
    """Estimate that a table was built from: `parameters` (p,) and their `covariance` (p, p)."""

    model: ErrorModel
    parameters: Array
    covariance: Array


@dataclass(frozen=True, eq=False)
class ExportSource:
    """A table, and its estimate if there is one."""

    table: CompensationTable
    estimate: TableEstimate | None = None


@dataclass(frozen=True, eq=False)
class ControllerExport:
    """Result of an export.

    `files`: name to text. `correction`: correction that the files make the controller add, rounded as they are,
    whichever sign the controller wants. `losses`: features of the table that the format cannot represent, in words.
    `facts`: figures that have to be set by hand.
    """

    files: Mapping[str, str]
    correction: Correction
    losses: tuple[str, ...]
    facts: Facts = field(default_factory=dict)


class FormatWriter(Protocol):
    def __call__(self, source: ExportSource, choices: ExportOptions) -> ControllerExport:
        """Write the files of the export. Raises DataError with reason and hint if the format cannot represent the
        table.
        """
        ...


@dataclass(frozen=True)
class ExportFormat:
    """Format of a controller: its name, its writer, and the options that the writer reads."""

    name: str
    export: FormatWriter
    options: tuple[FormatOption[Any], ...] = ()
