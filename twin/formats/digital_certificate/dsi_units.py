r"""Units as D-SI writes them, such as `\micro\metre` or `\per\kelvin` (D-SI guide of the SmartCom project, BIPM SI
brochure)."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from twin.errors import DataError

PREFIXES: Final[Mapping[str, float]] = {
    "kilo": 1e3, "hecto": 1e2, "deca": 1e1, "deci": 1e-1, "centi": 1e-2, "milli": 1e-3, "micro": 1e-6, "nano": 1e-9,
    "pico": 1e-12,
}  # fmt: skip
_UNITS: Final[Mapping[str, tuple[float, Mapping[str, int]]]] = {
    "metre": (1.0, {"metre": 1}),
    "kelvin": (1.0, {"kelvin": 1}),
    "radian": (1.0, {"radian": 1}),
    "one": (1.0, {}),
    "percent": (1e-2, {}),
    "ppm": (1e-6, {}),
}
_TOKEN: Final = re.compile(r"\\([A-Za-z]+)(?:\{([+-]?\d{1,2})\})?")
_LONGEST: Final = 100
_LARGEST_POWER: Final = 4

DEGREE_CELSIUS: Final = r"\degreecelsius"
METRE: Final[Mapping[str, int]] = {"metre": 1}
PER_KELVIN: Final[Mapping[str, int]] = {"kelvin": -1}


@dataclass(frozen=True)
class DsiUnit:
    """Unit with the factor to SI units without prefixes, and the exponent of each of these units."""

    factor: float
    exponents: Mapping[str, int]


def parse_unit(text: str) -> DsiUnit:
    r"""Return the unit that `text` names. A prefix applies to the unit after it, `\tothe{n}` raises it to the power n,
    and all units after `\per` divide.

    Raise DataError if the text is not a unit of length, temperature difference or angle, or a number, or if a power is
    beyond 4.
    """
    words = _TOKEN.findall(text)
    if len(text) > _LONGEST or _TOKEN.sub("", text).strip() or not words:
        raise _unknown(text)
    factor, exponents = 1.0, dict[str, int]()
    at, end, sign = 0, len(words), 1
    while at < end:
        if words[at] == ("per", ""):
            at, sign = at + 1, -1
        prefix = PREFIXES.get(words[at][0], 1.0) if at < end and not words[at][1] else 1.0
        at += at < end and words[at][0] in PREFIXES and not words[at][1]
        if at == end or words[at][0] not in _UNITS or words[at][1]:
            raise _unknown(text)
        size, dimension = _UNITS[words[at][0]]
        at, power = at + 1, 1
        if at < end and words[at][0] == "tothe" and words[at][1]:
            at, power = at + 1, int(words[at][1])
        if abs(power) > _LARGEST_POWER:
            raise _unknown(text)
        factor *= (prefix * size) ** (sign * power)
        for name, exponent in dimension.items():
            exponents[name] = exponents.get(name, 0) + sign * power * exponent
    if not (math.isfinite(factor) and factor > 0.0):
        raise _unknown(text)
    return DsiUnit(factor, {name: exponent for name, exponent in exponents.items() if exponent})


def factor_to(text: str, exponents: Mapping[str, int]) -> float:
    """Return the factor that takes values in the unit `text` to the SI unit with the `exponents`. Raise DataError if
    the unit is of another kind."""
    unit = parse_unit(text)
    if dict(unit.exponents) != dict(exponents):
        wanted = " ".join(f"{name}^{power}" for name, power in exponents.items()) or "a number"
        raise DataError(f"the unit '{text}' does not measure what is stated here ({wanted})")
    return unit.factor


def _unknown(text: str) -> DataError:
    return DataError(
        f"the unit '{text[:_LONGEST]}' is not known",
        hint=r"Lengths are in \metre with a prefix, such as \milli\metre",
    )
