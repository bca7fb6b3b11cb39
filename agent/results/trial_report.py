"""Result of a trial, the measurement of one ball with which a machine is commissioned."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from agent.probing.ball import FittedBall
from agent.probing.preparation import DatumBall, PreparationResult
from agent.results.homing_scatter import HomingScatter
from agent.results.probe_facts import check_rows
from twin.arrays import Array
from twin.units import UM_PER_MM

OFFSET_SHARE = 0.5
"""Fraction of the search distance from which the offset of a ball is reported: the place stated in the settings should
be corrected before a ball is missed."""


@dataclass(frozen=True)
class TrialReport:
    """Result of a trial, in which one ball is measured and nothing is written.

    The artefact stood at `station` with the orientation `azimuth_deg`, `elevation_deg`. `expected_mm` and `found_mm`
    are the axis positions at the centre of ball `ball`, as expected from the settings and as displayed by the
    controller. `expected_radius_mm` is the sum of the nominal radii of ball and tip, and `radius_mm` the radius of the
    sphere through the touches; it is smaller by the pretravel. `checks` contains the name and the result of each
    further check as texts, and `warnings` what should be looked at before the first calibration. `homing` is the
    scatter of the homing; it is None if it was not measured.
    """

    station: int
    azimuth_deg: float
    elevation_deg: float
    ball: int
    expected_mm: tuple[float, float, float]
    found_mm: tuple[float, float, float]
    expected_radius_mm: float
    radius_mm: float
    form_um: float
    checks: tuple[tuple[str, str], ...]
    latch_delay_ms: float | None
    warnings: tuple[str, ...]
    homing: HomingScatter | None = None

    @property
    def offset_mm(self) -> tuple[float, float, float]:
        """Distance of the centre from where it was expected, along X, Y and Z."""
        x, y, z = (found - expected for found, expected in zip(self.found_mm, self.expected_mm, strict=True))
        return x, y, z

    def as_json(self) -> dict[str, object]:
        """Return this result as the JSON object that docs/reference/json.md describes."""
        return {
            **vars(self),
            "offset_mm": list(self.offset_mm),
            "expected_mm": list(self.expected_mm),
            "found_mm": list(self.found_mm),
            "checks": dict(self.checks),
            "warnings": list(self.warnings),
            "homing": None if self.homing is None else self.homing.as_json(),
        }


def trial_report(
    prepared: PreparationResult, datum: DatumBall, after_homings: Sequence[FittedBall] = ()
) -> TrialReport:
    """Return the result of a trial from the checks that were made on the ball `datum`. `after_homings` contains this
    ball as it was found after each homing, if the axes were homed."""
    latch, position = prepared.latch, datum.position
    warnings = [w for check in (latch, prepared.reversal) if check is not None for w in check.warnings]
    report = TrialReport(
        station=position.station,
        azimuth_deg=position.azimuth_deg,
        elevation_deg=position.elevation_deg,
        ball=datum.ball,
        expected_mm=_coordinates(datum.expected_mm),
        found_mm=_coordinates(datum.found.centre_mm),
        expected_radius_mm=prepared.rules.probing.contact_mm,
        radius_mm=datum.found.radius_mm,
        form_um=datum.found.form_mm * UM_PER_MM,
        checks=check_rows(prepared),
        latch_delay_ms=None if latch is None else latch.delay_ms,
        warnings=tuple(warnings),
        homing=HomingScatter.of(prepared, after_homings) if after_homings else None,
    )
    search_mm = prepared.rules.probing.wide_search.beyond_mm
    distance_mm = float(np.linalg.norm(report.offset_mm))
    if prepared.placed is not None or distance_mm <= OFFSET_SHARE * search_mm:
        return report
    return replace(report, warnings=(*warnings, _offset_warning(report, distance_mm, search_mm)))


def _offset_warning(report: TrialReport, distance_mm: float, search_mm: float) -> str:
    x, y, z = report.offset_mm
    return (
        f"The ball stands {distance_mm:.1f} mm from where the settings expect it (X {x:+.2f}, Y {y:+.2f}, "
        f"Z {z:+.2f} mm); the search ends after {search_mm:g} mm. Correct the place of station {report.station} in "
        "`stations.places_mm`, or the zero of the mount."
    )


def _coordinates(point_mm: Array) -> tuple[float, float, float]:
    x, y, z = point_mm.tolist()
    return x, y, z
