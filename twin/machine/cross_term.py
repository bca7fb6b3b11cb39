"""Cross-effect terms: parts of the error motion of one axis that depend on the positions of other axes, too."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from twin.immutable import Immutable
from twin.machine.axis_polynomial import AxisPolynomial

CROSS = "CROSS"
_Y, _YZ, _YZZ = (AxisPolynomial((((0, 1, power), 1.0),)) for power in (0, 1, 2))


@dataclass(frozen=True)
class CrossTerm(Immutable):
    """Function of the axis positions that is added to an error motion, times the parameter `name`.

    `error` is the ISO name of the error motion. `polynomial` depends on the axis positions as fractions of the ranges.
    """

    name: str
    error: str
    polynomial: AxisPolynomial

    @property
    def unit(self) -> Literal["mm", "rad"]:
        return "rad" if self.error[1] in "ABC" else "mm"


COLUMN_AND_RAM: Mapping[str, CrossTerm] = {
    "b0": CrossTerm("CROSS[b0]", "EYZ", _Y),
    "b1": CrossTerm("CROSS[b1]", "EYZ", _YZ),
    "b2": CrossTerm("CROSS[b2]", "EYZ", _YZZ),
    "c0": CrossTerm("CROSS[c0]", "EAZ", _Y),
    "c1": CrossTerm("CROSS[c1]", "EAZ", _YZ),
}
"""Terms of a column that is bent by a ram, by their short names: E_YZ = (b0 + b1 z + b2 z²) y, E_AZ = (c0 + c1 z) y."""
