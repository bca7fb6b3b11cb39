"""Stylus qualification by dense touches of one ball. It gives the effective radius, that is, the radius of ball and tip
together as the probe measures it. If a pretravel map is requested, it also gives the pretravel for each direction."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from agent.execution.steps import Plan, Record
from agent.probing.ball import FittedBall, measure_ball
from agent.probing.probing_parameters import BallLimits, ProbingParameters, Stylus
from twin.arrays import Array
from twin.artefact.pretravel import PretravelMap, fit_pretravel
from twin.artefact.sphere_fit import fit_sphere
from twin.artefact.touch_pattern import centre_covariance, known_radius_covariance
from twin.units import UM_PER_MM


@dataclass(frozen=True, eq=False)
class QualificationRules:
    """Rules of a stylus qualification.

    `directions` (k, 3) holds the k touch directions of the dense pattern; the first of them points to the pole, which
    faces the stylus. `ball` is the number of the ball on which the stylus is qualified; if it is None, the first ball
    that is accessible from all directions is used. `with_map` is True if a map of the pretravel is fitted. `spread_mm`
    is the standard deviation of the radii of the artefact's balls.
    """

    directions: Array
    ball: int | None
    with_map: bool
    limits: BallLimits
    spread_mm: float

    def radius_sigma_mm(self, touch_sigma_mm: float) -> float:
        """Return the standard uncertainty of the qualified radius for any ball: that of the dense fit, and the spread
        of the balls' radii."""
        dense = fit_sphere(-self.directions, touch_sigma_mm)
        return float(np.hypot(np.sqrt(dense.covariance[3, 3]), self.spread_mm))

    def centre_covariance(self, probing: ProbingParameters) -> Array:
        """Return the covariance (3, 3) in mm² that planning expects of a ball centre: with a free radius if the touches
        determine it, otherwise with the radius of this qualification."""
        directions, sigma_mm = probing.directions, probing.touch_sigma_mm
        if probing.determines_radius:
            return centre_covariance(directions, sigma_mm)
        return known_radius_covariance(directions, sigma_mm, self.radius_sigma_mm(sigma_mm))


@dataclass(frozen=True, eq=False)
class Qualification:
    """Result of a stylus qualification.

    `trace_free_um2` and `trace_fixed_um2` are traces of the covariance of a ball centre that is measured with the touch
    pattern of the run. The first is valid if the sphere is fitted with a free radius, the second if it is fitted with a
    fixed radius. The fit with the smaller trace is used for the run. The first is None if the touches do not determine
    a radius. `datum_mm` is the centre of the ball used.
    """

    stylus: Stylus
    datum_mm: Array
    form_um: float
    directions: Array
    residuals_um: Array
    trace_free_um2: float | None
    trace_fixed_um2: float

    @property
    def text(self) -> str:
        stylus = self.stylus
        how = "fixed" if stylus.fixed else "free"
        free = "" if self.trace_free_um2 is None else f", {self.trace_free_um2:.2f} µm² free"
        text = (
            f"effective radius {stylus.radius_mm:.4f} mm ± {2.0 * stylus.radius_sigma_mm * UM_PER_MM:.1f} µm (2σ), "
            f"form {self.form_um:.1f} µm of {len(self.directions)} touches; spheres are fitted with the radius {how} "
            f"(trace of a centre's covariance {self.trace_fixed_um2:.2f} µm² fixed{free})"
        )
        if stylus.pretravel is not None:
            text += (
                f"; pretravel map up to {stylus.pretravel.largest_mm * UM_PER_MM:.1f} µm, "
                f"{stylus.pretravel.noise_mm * UM_PER_MM:.1f} µm rms residual"
            )
        return text


def qualify_stylus(
    key: str, centre: Array, probing: ProbingParameters, rules: QualificationRules
) -> Plan[Qualification]:
    """Touch the ball at `centre` in the dense pattern `rules.directions` and qualify the stylus.

    Raises MeasurementFault if this ball cannot be measured within its limits. In this case, later measurements would
    not be trustworthy either.
    """
    dense = replace(probing, directions=rules.directions, limits=rules.limits, stylus=None, stop_on_failure=True)
    found = yield from measure_ball(key, centre, dense, dense.narrow_search)
    assert isinstance(found, FittedBall)  # noqa: S101  a lost ball stops the plan
    result = qualification_of(found, probing, rules)
    yield Record(f"{key}/stylus", "decision", _payload(key, result))
    return result


def qualification_of(found: FittedBall, probing: ProbingParameters, rules: QualificationRules) -> Qualification:
    """Return the stylus qualification that results from the densely touched ball `found`. Later spheres are fitted with
    the qualified radius as fixed radius if this reduces the uncertainty of their centres."""
    sigma_mm, radius_sigma_mm = probing.touch_sigma_mm, rules.radius_sigma_mm(probing.touch_sigma_mm)
    free: float | None = None
    if probing.determines_radius:
        free = float(np.trace(centre_covariance(probing.directions, sigma_mm)))
    fixed = float(np.trace(known_radius_covariance(probing.directions, sigma_mm, radius_sigma_mm)))
    # The fit with the smaller trace of the centre's covariance is used.
    is_fixed = free is None or fixed < free
    stylus = Stylus(found.radius_mm, radius_sigma_mm, is_fixed, _map(found, probing, rules))
    return Qualification(
        stylus=stylus,
        datum_mm=found.centre_mm,
        form_um=found.form_mm * UM_PER_MM,
        directions=rules.directions,
        residuals_um=found.residuals_mm * UM_PER_MM,
        trace_free_um2=None if free is None else free * UM_PER_MM**2,
        trace_fixed_um2=fixed * UM_PER_MM**2,
    )


def _map(found: FittedBall, probing: ProbingParameters, rules: QualificationRules) -> PretravelMap | None:
    if not rules.with_map:
        return None
    return fit_pretravel(rules.directions, found.residuals_mm, probing.stylus_axis)


def _payload(key: str, result: Qualification) -> dict[str, object]:
    stylus = result.stylus
    payload: dict[str, object] = {
        "text": result.text,
        "ball": key,
        "datum_mm": result.datum_mm,
        "radius_mm": stylus.radius_mm,
        "radius_sigma_um": stylus.radius_sigma_mm * UM_PER_MM,
        "radius_fixed": stylus.fixed,
        "form_um": result.form_um,
        "residuals_um": result.residuals_um,
    }
    if stylus.pretravel is not None:
        payload["pretravel_um"] = stylus.pretravel.coefficients_mm * UM_PER_MM
    return payload
