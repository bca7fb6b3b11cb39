"""Definition of an export format of a controller, with its input and its output."""

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
    """Estimate from which a table was built: `parameters` (p,) of `model` and their `covariance` (p, p)."""

    model: ErrorModel
    parameters: Array
    covariance: Array


@dataclass(frozen=True, eq=False)
class ExportSource:
    """Table to be exported and, if there is one, the estimate from which the table was built."""

    table: CompensationTable
    estimate: TableEstimate | None = None


@dataclass(frozen=True, eq=False)
class ControllerExport:
    """Result of an export.

    `files`: map from file name to text. `correction`: function that returns the correction that the controller adds if
    it reads these files; it contains their rounding, and its sign does not depend on the sign convention of the format.
    `losses`: descriptions of the features of the table that the format cannot represent. `facts`: values that have to
    be set by hand.
    """

    files: Mapping[str, str]
    correction: Correction
    losses: tuple[str, ...]
    facts: Facts = field(default_factory=dict)


class FormatWriter(Protocol):
    def __call__(self, source: ExportSource, choices: ExportOptions) -> ControllerExport:
        """Return the files of the export and their effect.

        Raises DataError with reason and hint if the format cannot represent the table.
        """
        ...


@dataclass(frozen=True)
class ExportFormat:
    """Format of a controller: its name, its writer, and the options that the writer reads."""

    name: str
    export: FormatWriter
    options: tuple[FormatOption[Any], ...] = ()
