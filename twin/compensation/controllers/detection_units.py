"""Corrections in the form in which FANUC controllers store them. Each correction is an integer, which the controller
multiplies by a detection unit (a length in µm that is set in the controller) and a magnification.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from twin.arrays import Array
from twin.compensation.controllers.all_options import DETECTION_UNIT_UM, LARGEST_MAGNIFICATION, MAGNIFICATION
from twin.compensation.controllers.format_options import ExportOptions
from twin.errors import DataError

CountArray = np.ndarray[Any, np.dtype[np.int64]]


@dataclass(frozen=True)
class CountUnit:
    """Length that corresponds to one count, that is, to the value 1 of a stored integer correction. It is the product
    of `detection_unit_um` (in µm) and `magnification`.
    """

    detection_unit_um: float
    magnification: int

    @property
    def mm(self) -> float:
        return 1e-3 * self.detection_unit_um * self.magnification

    def counts(self, values_mm: Array) -> CountArray:
        return np.round(values_mm / self.mm).astype(np.int64)

    def values(self, counts: CountArray) -> Array:
        """Convert an array of counts to lengths in mm."""
        return np.asarray(self.mm * counts, dtype=np.float64)

    def whole(self, length_mm: float, what: str) -> int:
        """Convert a length in mm to a number of detection units.

        Raises DataError if the length is not an integer multiple of the detection unit.
        """
        units = 1e3 * length_mm / self.detection_unit_um
        if abs(units - round(units)) > 1e-6:
            unit = f"the detection unit ({self.detection_unit_um:g} µm)"
            message = f"{what} of {length_mm:.9g} mm is not a multiple of {unit}"
            raise DataError(message, hint="Choose another grid with --points, so that steps are integer multiples")
        return round(units)


def smallest_unit(values_mm: list[Array], choices: ExportOptions, most: int, *, increments: bool) -> CountUnit:
    """Return the length of one count of the stored corrections, with the magnification that `choices` request. If no
    magnification is requested, use the smallest sufficient magnification.

    A magnification is sufficient if the absolute value of every written number is at most `most`. If `increments` is
    True, the written numbers are the differences between successive counts, otherwise the counts themselves. Raises
    DataError if the requested magnification is insufficient, or if no magnification is requested and even the largest
    is insufficient.
    """
    requested = choices[MAGNIFICATION]
    tried = range(1, LARGEST_MAGNIFICATION + 1) if requested is None else [requested]
    largest = 0
    for magnification in tried:
        unit = CountUnit(choices[DETECTION_UNIT_UM], magnification)
        numbers = [unit.counts(one) for one in values_mm]
        # The positions are rounded and not the increments, so that rounding errors do not add up along the axis.
        if increments:
            numbers = [np.diff(one) for one in numbers]
        largest = max(int(np.abs(one).max(initial=0)) for one in numbers)
        if largest <= most:
            return unit
    message = f"a value of {largest} exceeds ±{most} at magnification {tried[-1]}"
    hint = "Allow a larger --magnification, a finer grid with --points, or a larger --detection-unit-um"
    raise DataError(message, hint=hint)


def format_reference(reference: Array) -> str:
    """Return the machine position `reference` of the reference point as text for the operator.

    The controller counts the compensation points from this point, but no parameter contains its position.
    """
    return ", ".join(f"{value:.10g}" for value in reference.tolist())
