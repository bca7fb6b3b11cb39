"""Volumetric error in two parts of the travel: where balls were measured, and where none were.

An estimate is good where balls were, and outside it rests on the prior population of the machine and on the form of the
error model. One figure over the whole travel hides this difference.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Self

Limits = tuple[float, float]


@dataclass(frozen=True)
class TravelPart:
    """Volumetric error in one part of the travel, in µm.

    `share` is the part's share of the grid points of the whole travel. The other values are those of the whole travel
    (`VolumetricSummary`), taken over this part: `estimated_ve_um` is the volumetric error (VE) expected without
    compensation, which contains the errors that were not determined; `table_ve_um` is that of the estimated parameters
    alone, which the table corrects; and `predicted_vce_um` is the volumetric compensated error (VCE) expected with the
    table active. The best-fitting rigid motion of the whole travel has been removed from all of them, so that the
    squares of the two parts, weighted by their shares, add up to the square of the whole travel. The limits are those
    of the 95 % intervals.
    """

    share: float
    estimated_ve_um: float
    estimated_ve_limits_um: Limits
    table_ve_um: float
    predicted_vce_um: float
    predicted_vce_limits_um: Limits


@dataclass(frozen=True)
class TravelParts:
    """Volumetric error inside the measured region (`measured`) and outside it (`unmeasured`). A part is None if it has
    no grid point."""

    measured: TravelPart | None
    unmeasured: TravelPart | None

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> Self:
        """Return the parts that `as_record` has written."""
        return cls(*(_part(record[name]) for name in ("measured", "unmeasured")))

    def as_record(self) -> dict[str, Any]:
        """Return the parts as a JSON object."""
        return asdict(self)


def _part(record: Mapping[str, Any] | None) -> TravelPart | None:
    if record is None:
        return None
    limits = {name: tuple(record[name]) for name in ("estimated_ve_limits_um", "predicted_vce_limits_um")}
    return TravelPart(**{**record, **limits})
