"""Data of a run that the journal stores and reports show, as immutable values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.position_set import CHECKABLE_BALLS
from twin.compensation.table import CompensationTable


def unchecked_text(count: int, positions: int, touches: int) -> str:
    """Return the statement that in `count` of all `positions` a wrong touch cannot be told, if each ball is touched so
    few times (`touches`) that its balls can only be checked against each other."""
    have = "position has" if count == 1 else "positions have"
    return (
        f"{count} of {positions} {have} fewer than {CHECKABLE_BALLS} balls; a wrong one of {touches} touches cannot be "
        "told there"
    )


@dataclass(frozen=True)
class Quantity:
    """Length in µm with its standard uncertainty and its 95 % limits, each of which is None if it is not known."""

    value_um: float
    standard_uncertainty_um: float | None = None
    limits_um: tuple[float, float] | None = None


@dataclass(frozen=True)
class VolumetricSummary:
    """Estimated volumetric error (VE) of the machine without compensation, and predicted volumetric compensated error
    (VCE), which remains with the table active.

    Both are computed after removal of the best-fitting rigid motion of the workspace: no free artefact sees that
    motion, so nothing that is measured can tell how large it is. `table_ve_um` is the volumetric error of the estimated
    parameters alone, which the table corrects. The estimated VE also contains the errors that were not determined.
    """

    before_aligned: Quantity
    after_aligned: Quantity
    table_ve_um: float


@dataclass(frozen=True)
class ArtefactFacts:
    """Properties of the artefact according to its certificate. `balls` is the number of balls."""

    name: str
    certificate: str
    balls: int
    ball_diameter_mm: float
    reference_temperature_c: float
    cte_per_k: float
    cte_standard_uncertainty_per_k: float

    @classmethod
    def of(cls, artefact: Artefact) -> Self:
        return cls(
            name=artefact.name,
            certificate=artefact.certificate,
            balls=artefact.count,
            ball_diameter_mm=artefact.ball_diameter_mm,
            reference_temperature_c=artefact.reference_temperature_c,
            cte_per_k=artefact.cte_per_k,
            cte_standard_uncertainty_per_k=artefact.cte_standard_uncertainty_per_k,
        )


@dataclass(frozen=True)
class TableFacts:
    """Summary of a compensation table.

    `nodes` contains the numbers of grid nodes along X, Y and Z. `largest_um` contains the largest absolute correction
    of each axis. `extrapolated` is the number of nodes outside the measured region. `anchor_mm` is the point at which
    the correction is zero, with the reference directions `primary` and `secondary`. `crc32` is the CRC-32 checksum of
    the table's CSV file.
    """

    nodes: tuple[int, int, int]
    largest_um: tuple[float, float, float]
    anchor_mm: tuple[float, float, float]
    primary: str
    secondary: str
    tool_offset_mm: tuple[float, float, float]
    extrapolated: int
    crc32: str

    @classmethod
    def of(cls, table: CompensationTable, crc32: str) -> Self:
        x, y, z = table.extrapolated.shape
        anchor = table.anchor
        return cls(
            nodes=(x, y, z),
            largest_um=triple(1e3 * np.abs(table.corrections).max(axis=(0, 1, 2))),
            anchor_mm=triple(anchor.point_mm),
            primary=anchor.primary,
            secondary=anchor.secondary,
            tool_offset_mm=triple(table.tool_offset),
            extrapolated=int(table.extrapolated.sum()),
            crc32=crc32,
        )

    @property
    def cells(self) -> int:
        return int(np.prod(self.nodes))


def triple(values: Array) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return (x, y, z)


@dataclass(frozen=True)
class ProbeRing:
    """Touches of the stylus qualification at one latitude of the ball, and the map of the pretravel at that latitude.
    The pole, which faces the stylus, has the latitude 90°.

    `angle_deg` (k,) and `residual_um` (k,) contain the angle about the stylus and the residual of each of the k
    touches. `map_angle_deg` (m,) contains m angles, and `map_um` (m,) contains the pretravel at these angles. If there
    is no map, the arrays of the map are empty.
    """

    latitude_deg: float
    angle_deg: Array
    residual_um: Array
    map_angle_deg: Array
    map_um: Array


@dataclass(frozen=True)
class ProbeFacts:
    """Results of the checks of probe and stylus before the run.

    `rows` contains the name and the result of each check as texts. `rings` contains the touches of the stylus
    qualification, grouped by latitude.
    """

    rows: tuple[tuple[str, str], ...]
    rings: tuple[ProbeRing, ...] = ()
