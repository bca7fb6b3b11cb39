"""Family of machines whose error coefficients are distributed uniformly around zero."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from twin.arrays import Array, as_vector
from twin.errors import ModelError
from twin.machine.cross_term import CROSS
from twin.machine.error_model import ErrorModel, Parameter, series_orders

SERIES_KINDS = ("positioning_um", "straightness_um", "rotation_urad")
SINGLE_KINDS = ("squareness_urad", "cross_displacement_um", "cross_rotation_urad")
DEFAULT_DECAY = 0.6


@dataclass(frozen=True)
class Family:
    """Distribution of machines (prior population) in which parameter i of the error model `model` is uniform between
    -a_i and +a_i.

    The half-width a_i is element i of `half_widths` (p,), in mm or rad.
    """

    model: ErrorModel
    half_widths: Array

    def __post_init__(self) -> None:
        widths = as_vector(self.half_widths, self.model.size, "half-widths")
        if (widths < 0.0).any():
            name = self.model.names[int(np.argmin(widths))]
            raise ModelError("a half-width is negative", parameter=name)
        object.__setattr__(self, "half_widths", widths)

    @property
    def prior_standard_deviation(self) -> Array:
        """Standard deviation (p,) of each parameter: half-width divided by the square root of 3."""
        return self.half_widths / math.sqrt(3.0)

    def draw(self, rng: np.random.Generator, count: int) -> Array:
        """Draw `count` random machines from the family and return their parameter vectors (count, p)."""
        return rng.uniform(-1.0, 1.0, (count, self.model.size)) * self.half_widths


def family_from_amplitudes(model: ErrorModel, amplitudes: Mapping[str, float | Sequence[float]]) -> Family:
    """Return the family of machines in which each parameter has a uniform distribution with the half-width given for
    its kind of error.

    `amplitudes` maps kinds of error to half-widths. The kinds `positioning_um`, `straightness_um` and `rotation_urad`
    take one value for each Legendre order, starting at the lowest order of the kind (order 2 for a straightness,
    otherwise 1). They also accept a single value, which belongs to the lowest order. Beyond the last given order, the
    half-widths decrease by the factor `decay` (default 0.6) per order. The kinds `squareness_urad`,
    `cross_displacement_um` and `cross_rotation_urad` take one value each. The half-widths of a missing kind are zero.
    The name of a cross-effect parameter, such as `CROSS[b1]`, gives the half-width of this parameter alone in µm or
    µrad.
    """
    known = (*SERIES_KINDS, *SINGLE_KINDS, "decay")
    for name in amplitudes:
        if name not in known and not name.startswith(f"{CROSS}["):
            raise ModelError(f"unknown family amplitude '{name}'", hint=f"Known: {', '.join(known)}")
    widths = [_half_width(model, parameter, amplitudes) for parameter in model.parameters]
    return Family(model, np.array(widths))


def _half_width(model: ErrorModel, parameter: Parameter, amplitudes: Mapping[str, float | Sequence[float]]) -> float:
    kind = f"{parameter.kind}_{'um' if parameter.unit == 'mm' else 'urad'}"
    if parameter.error == CROSS and parameter.name in amplitudes:
        kind = parameter.name
    values = _as_list(amplitudes.get(kind, 0.0), kind)
    if kind in SINGLE_KINDS or kind == parameter.name:
        return 1e-3 * values[0] if parameter.unit == "mm" else 1e-6 * values[0]
    # a straightness begins at order 2, all others at order 1: rank counts from the lowest order of the kind
    rank = parameter.order - series_orders(parameter.error, model.orders[parameter.error]).start
    decay = _as_list(amplitudes.get("decay", DEFAULT_DECAY), "decay")[0]
    width = values[min(rank, len(values) - 1)] * decay ** max(0, rank - len(values) + 1)
    return width * (1e-3 if parameter.unit == "mm" else 1e-6)


def _as_list(values: float | Sequence[float], kind: str) -> list[float]:
    numbers = [float(value) for value in (values if isinstance(values, Sequence) else [values])]
    if not numbers or not all(math.isfinite(number) and number >= 0.0 for number in numbers):
        raise ModelError(f"family amplitude {kind} must contain finite values of at least zero")
    if kind not in SERIES_KINDS and len(numbers) != 1:
        raise ModelError(f"family amplitude {kind} must be one value, got {len(numbers)}")
    return numbers
