"""Flexibility of an Euler-Bernoulli beam at the point where a moving carriage loads it.

The carriage stands at the distance s from the first support. Only the response of the beam at this point matters to the
carriage. It is linear in the force P across the beam, the bending moment M and the torque T of the carriage:

    deflection  u = f_uP(s) P + f_uM(s) M
    slope       θ = f_uM(s) P + f_θM(s) M     θ = du/ds
    twist       φ = f_φT(s) T

with 1/EI (1/GJ for the twist) as the unit of the functions f, which are polynomials in s. The two functions f_uM are
the same by Maxwell's reciprocity, by which f_uM is also half of the derivative of f_uP.

Source: S. Timoshenko, Strength of Materials, Part I: beams with one load. For a beam of length L on two supports, with
b = L - s, the deflection under the load is P s² b² / 3EIL (simply supported) or P s³ b³ / 3EIL³ (clamped).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from numpy.polynomial import Polynomial

from twin.errors import ModelError

Ends = Literal["cantilever", "supported", "clamped"]
"""Supports of a beam. A `cantilever` is clamped at its foot. Either the carriage moves along it, or it slides through a
moving support and carries the load at its free end (a ram): in both cases s is the length between support and load. A
beam that is `supported` or `clamped` has two supports, which prevent its deflection and twist, or also its slope.
"""
ENDS: tuple[Ends, ...] = get_args(Ends)

_S = Polynomial([0.0, 1.0])


@dataclass(frozen=True)
class BeamFlexibility:
    """Coefficients, in ascending powers of the distance s in mm, of the functions f of a beam."""

    deflection_by_force: tuple[float, ...]
    deflection_by_moment: tuple[float, ...]
    slope_by_moment: tuple[float, ...]
    twist_by_torque: tuple[float, ...]


def beam_flexibility(ends: Ends, length_mm: float = 0.0) -> BeamFlexibility:
    """Return the flexibility of a beam. `length_mm` is the distance of its two supports, which a cantilever
    does not have."""
    if ends == "cantilever":
        return _flexibility(_S**3 / 3.0, _S**2 / 2.0, _S, _S)
    if not length_mm > 0.0:
        raise ModelError("a beam on two supports needs a positive length")
    rest = length_mm - _S
    twist = _S * rest / length_mm
    if ends == "supported":
        by_moment = _S * rest * (rest - _S) / (3.0 * length_mm)
        slope = (_S**2 - _S * rest + rest**2) / (3.0 * length_mm)
        return _flexibility(_S**2 * rest**2 / (3.0 * length_mm), by_moment, slope, twist)
    by_moment = _S**2 * rest**2 * (rest - _S) / (2.0 * length_mm**3)
    slope = _S * rest * (_S**2 - _S * rest + rest**2) / length_mm**3
    return _flexibility(_S**3 * rest**3 / (3.0 * length_mm**3), by_moment, slope, twist)


def _flexibility(*functions: Polynomial) -> BeamFlexibility:
    return BeamFlexibility(*(tuple(function.coef.tolist()) for function in functions))
