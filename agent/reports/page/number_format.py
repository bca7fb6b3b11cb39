"""Formatting of numbers and tables for the report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.figures.numbers import significant
from agent.results.facts import Quantity

COVERAGE = 2.0
"""Coverage factor of all expanded uncertainties of the report (GUM, about 95 %)."""
Rows = list[tuple[str, str]]
MINUS = "\N{MINUS SIGN}"


@dataclass(frozen=True)
class Table:
    """Table of formatted texts.

    Columns are identified by their headings. `numeric` lists the columns with numbers, `fine` lists the columns in
    small print, and `code` lists the columns without line breaks.
    """

    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    numeric: tuple[str, ...] = ()
    fine: tuple[str, ...] = ()
    code: tuple[str, ...] = ()


def number(value: float, digits: int = 3) -> str:
    """Return `value` as a text with `digits` significant digits and a typographic minus sign.

    An exponent is used only for very small values.
    """
    if value == 0.0:
        return "0"
    return significant(value, digits).replace("-", MINUS)


def fixed(value: float, decimals: int) -> str:
    return f"{round(value, decimals) + 0.0:.{decimals}f}".replace("-", MINUS)


def micrometres(quantity: Quantity | None) -> str:
    """Return a text such as `12.3 µm, 95 % limits 11.6 to 13.4 µm` or, if the limits are not known, `12.3 ± 0.8 µm`,
    in which the second number is the expanded uncertainty (k = 2). The text is a dash if `quantity` is None."""
    if quantity is None:
        return "–"
    decimals = 1 if quantity.value_um >= 10.0 else 2
    value = fixed(quantity.value_um, decimals)
    if quantity.limits_um is not None:
        lower, upper = (fixed(limit, decimals) for limit in quantity.limits_um)
        return f"{value} µm, 95 % limits {lower} to {upper} µm"
    if quantity.standard_uncertainty_um is None:
        return f"{value} µm"
    return f"{value} ± {fixed(COVERAGE * quantity.standard_uncertainty_um, decimals)} µm"


def point(values: Sequence[float] | NDArray[np.float64]) -> str:
    return "(" + ", ".join(number(float(value), 6) for value in values) + ") mm"


def plural(count: int, noun: str) -> str:
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"
