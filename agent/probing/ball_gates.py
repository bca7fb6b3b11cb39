"""Gates (limits) that a fitted ball must pass, and the choice of the touches that are repeated if the ball fails a
gate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from agent.probing.probing_parameters import ProbingParameters
from twin.artefact.sphere_fit import SphereFit
from twin.units import UM_PER_MM

TIE_RATIO = 0.95
"""Fraction of the largest standardised residual above which a touch cannot be distinguished from the worst touch.

The actual touch directions deviate from the pattern, because the ball may be off its expected centre by up to the
re-centring limit, a few percent of its radius."""
MIN_POLE_REDUNDANCY = 0.05
"""Redundancy of the pole touch below which the other touches do not determine the sphere at the pole."""


@dataclass(frozen=True)
class FailedGate:
    """Gate (limit) that a fitted ball did not pass, with the value found (`figure_um`), the limit and a text with
    both."""

    gate: str
    figure_um: float
    limit_um: float
    text: str

    def payload(self, ball: str, then: str) -> dict[str, object]:
        """Return the payload of the journal record about this gate. `ball` is the key of the ball in the run, and
        `then` is a text that states what is done next."""
        return {
            "ball": ball,
            "gate": self.gate,
            "figure_um": round(self.figure_um, 3),
            "limit_um": self.limit_um,
            "reason": self.text,
            "then": then,
        }


def first_failed_gate(fit: SphereFit, probing: ProbingParameters) -> FailedGate | None:
    """Return the first gate that `fit`, a sphere fitted with a free radius, does not pass; None if it passes all
    gates."""
    limits = probing.limits
    deviation = fit.radius - probing.expected_radius_mm
    worst = int(np.abs(fit.residuals).argmax())
    pole = pole_error_mm(fit, probing)
    checks = (
        ("radius", deviation, limits.radius_deviation_mm, "radius is off by"),
        ("form", fit.form, limits.form_mm, "form is"),
        ("touch", fit.residuals[worst], limits.touch_mm, f"touch {worst} is off the sphere by"),
        ("pole", 0.0 if pole is None else pole, limits.pole_mm, "the pole is off the sphere through the rest by"),
    )
    for gate, value_mm, limit_mm, words in checks:
        figure_um, limit_um = float(value_mm) * UM_PER_MM, limit_mm * UM_PER_MM
        if abs(figure_um) > limit_um:
            text = f"{words} {figure_um:.1f} µm, allowed {limit_um:.1f} µm"
            return FailedGate(gate, figure_um, limit_um, text)
    return None


def pole_error_mm(fit: SphereFit, probing: ProbingParameters) -> float | None:
    """Return the distance in mm of the touch at the pole from the sphere through all other touches; None for the
    pattern of five touches, one at the pole and four on the equator.

    To first order, the distance is the residual of the pole touch divided by its redundancy, which is the fraction of a
    touch's error that appears in its residual. In the pattern of five touches, the four equator touches lie in one
    plane and determine no sphere. With that pattern, a late trip at the pole looks like a ball that is farther away.
    """
    share = float(probing.redundancies[0])
    return float(fit.residuals[0]) / share if share > MIN_POLE_REDUNDANCY else None


def doubtful_touches(fit: SphereFit, probing: ProbingParameters) -> tuple[int, ...]:
    """Return the indices of the touches to repeat: the worst touch, and each touch that the pattern of touch directions
    cannot distinguish from it.

    The redundancy of a touch is the fraction of its error that appears in its residual. To find the worst touch, each
    residual is divided by the square root of the redundancy (Baarda's test). If a pole touch and four equator touches
    are fitted with a free radius, a wrong touch on the equator changes the residuals of the four equator touches
    equally. All four are then repeated.
    """
    # Standardised residual w_i = |v_i| / √r_i; touches without redundancy have none.
    shown = np.sqrt(probing.redundancies)
    weighed = np.divide(np.abs(fit.residuals), shown, out=np.zeros_like(shown), where=shown > 0.0)
    largest = weighed.max()
    return tuple(int(i) for i in np.flatnonzero(weighed >= TIE_RATIO * largest)) if largest > 0.0 else ()
