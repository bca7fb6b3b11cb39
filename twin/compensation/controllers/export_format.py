"""Data types of an export to a controller: its input, its result, and the definition of its format."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol

from twin.arrays import Array
from twin.compensation.controllers.format_options import ExportOptions
from twin.compensation.table import CompensationTable
from twin.display import Displayed
from twin.machine.error_model import ErrorModel

Correction = Callable[[Array], Array]
"""Function from axis positions (n, 3) in mm to the corrections that the controller adds to them, (n, 3) in mm."""

Facts = Mapping[str, str | int | float]


@dataclass(frozen=True, eq=False)
class TableEstimate:
    """Estimate of the machine errors from which a compensation table was built. It consists of p identified parameters
    of `model` and their covariance (p, p).
    """

    model: ErrorModel
    parameters: Array
    covariance: Array


@dataclass(frozen=True, eq=False)
class ExportSource:
    """Compensation table to be exported. `estimate` is the estimate of the machine errors from which the table was
    built, or None if it is not available.
    """

    table: CompensationTable
    estimate: TableEstimate | None = None


@dataclass(frozen=True, eq=False)
class ControllerExport(Displayed):
    """Result of an export.

    - `files` maps each file name to the text of the file.
    - `correction` is a function that predicts the correction of the controller if it reads these files. It includes the
      rounding of the values in the files. Its result is the displacement that the controller adds to the command. The
      sign of the result does not depend on the sign convention of the format.
    - `losses` describes the features of the table that the format cannot represent.
    - `facts` contains values for the operator, for example values that have to be set by hand in the controller.
    """

    files: Mapping[str, str]
    correction: Correction
    losses: tuple[str, ...]
    facts: Facts = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"<ControllerExport: {len(self.files)} files, {len(self.losses)} losses>"


class FormatWriter(Protocol):
    def __call__(self, source: ExportSource, choices: ExportOptions) -> ControllerExport:
        """Return the files of the export and their effect.

        Raises DataError with reason and hint if the format cannot represent the table.
        """
        ...


@dataclass(frozen=True)
class ExportFormat:
    """Export format of a controller. It has a name and a function that creates the files; `OPTIONS_OF_FORMATS` has the
    options that this function reads.
    """

    name: str
    export: FormatWriter
