"""Values of a quantity in D-SI with their uncertainties, in the current form of the schema (2.2) and in the form that
it replaces (1.3 to 2.1)."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from lxml import etree

from twin.arrays import Array
from twin.errors import DataError
from twin.formats.digital_certificate.dsi_units import DEGREE_CELSIUS, factor_to
from twin.formats.digital_certificate.xml_reading import SI, child, children, is_named, local_name, refused, text_of

VALUES: Final = ("real", "realListXMLList", "hybrid")
"""Elements of D-SI that can be read."""

MAX_VALUES: Final = 300
"""Number of values of one quantity at most: three coordinates of a hundred balls."""

# decimal numbers of XML Schema, without NaN and infinity
_NUMBER: Final = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,3})?")
_CONTRADICTION: Final = 0.05  # a covariance and an uncertainty of the same value that differ by more are not the same


@dataclass(frozen=True, eq=False)
class DsiValues:
    """Values (n,) of a quantity in SI units without prefixes, with their standard uncertainties (n,) and covariance
    (n, n), each of which is None if it is not stated."""

    values: Array
    standard_uncertainties: Array | None = None
    covariance: Array | None = None

    @property
    def full_covariance(self) -> Array | None:
        """Covariance (n, n), diagonal if only standard uncertainties are stated; None if nothing is."""
        if self.covariance is not None or self.standard_uncertainties is None:
            return self.covariance
        return np.diag(self.standard_uncertainties**2)


def read_values(quantity: etree._Element, exponents: Mapping[str, int], source: str) -> DsiValues:
    """Return the values of a `dcc:quantity` in the SI unit with the `exponents`. Of a hybrid, which states a quantity
    in several units, the first one is read.

    Raise FormatError, which names `source` and the element, if a part of the quantity cannot be understood.
    """
    relative = [one for one in quantity if local_name(one) == "relativeUncertainty"]
    if relative:
        raise refused(
            "a relative uncertainty is not understood", relative[0], source, "State it in the unit of the value"
        )
    found = child(quantity, SI, *VALUES)
    if found is not None and is_named(found, SI, "hybrid"):
        found = child(found, SI, *VALUES[:2])
    if found is None:
        kinds = " or ".join(f"si:{name}" for name in VALUES)
        raise refused("the quantity has no value that is understood", quantity, source, f"It needs {kinds}")
    return _Reader(source, exponents).values(found)


def read_celsius(quantity: etree._Element, source: str) -> float:
    r"""Return the temperature of a `dcc:quantity` in °C, which is stated in `\degreecelsius` or `\kelvin`. Raise
    FormatError as `read_values` does."""
    found = child(quantity, SI, "real")
    unit = child(quantity if found is None else found, SI, "unit")
    if found is not None and text_of(unit) == DEGREE_CELSIUS:
        (value,) = _Reader(source, {}).numbers(child(found, SI, "value"), found, 1)
        return float(value)
    return float(read_values(quantity, {"kelvin": 1}, source).values[0]) - 273.15


@dataclass(frozen=True)
class _Reader:
    source: str
    exponents: Mapping[str, int]

    def values(self, found: etree._Element) -> DsiValues:
        ending = "XMLList" if is_named(found, SI, "realListXMLList") else ""
        known = {
            "label", "labelXMLList", "quantityTypeQUDT", "quantityTypeQUDTXMLList", f"value{ending}", f"unit{ending}",
            "significantDigit", "significantDigitXMLList", "dateTime", "dateTimeXMLList", *_UNIVARIATE, *_MULTIVARIATE,
        }  # fmt: skip
        for one in found:
            if local_name(one) not in known:
                raise refused(f"the element {local_name(one)} of a quantity is not understood", one, self.source)
        values = self.numbers(child(found, SI, f"value{ending}"), found, None if ending else 1)
        factors = self.factors(child(found, SI, f"unit{ending}"), found, len(values), self.exponents)
        doubt, spread = child(found, SI, *_UNIVARIATE), child(found, SI, *_MULTIVARIATE)
        sigma = None if doubt is None else self.standard_uncertainties(doubt, len(values))
        covariance = None if spread is None else self.covariance(spread, len(values))
        sigma = None if sigma is None else sigma * np.abs(factors)
        if spread is not None and covariance is not None and sigma is not None:
            stated = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
            if np.abs(stated - sigma).max() > _CONTRADICTION * max(float(sigma.max()), 1e-300):
                raise refused("the covariance contradicts the uncertainties of the same values", spread, self.source)
        return DsiValues(values * factors, sigma, covariance)

    def numbers(self, element: etree._Element | None, parent: etree._Element, count: int | None) -> Array:
        """Return the numbers (n,) in the text of an element of `parent`, which are `count` unless that is None."""
        if element is None:
            raise refused("a number is missing here", parent, self.source)
        words = text_of(element).split()
        if not 0 < len(words) <= MAX_VALUES:
            raise refused(f"{len(words)} numbers where 1 to {MAX_VALUES} are expected", element, self.source)
        for word in words:
            if _NUMBER.fullmatch(word) is None or not math.isfinite(float(word)):
                raise refused(f"'{word[:40]}' is not a finite number", element, self.source)
        if count is not None and len(words) != count:
            raise refused(f"{len(words)} numbers where {count} are expected", element, self.source)
        return np.array([float(word) for word in words])

    def spread_over(self, element: etree._Element | None, parent: etree._Element, count: int) -> Array:
        """Return `count` numbers. A single one stands for all of them."""
        found = self.numbers(element, parent, None)
        if len(found) not in (1, count):
            raise refused(f"{len(found)} numbers where 1 or {count} are expected", parent, self.source)
        return np.broadcast_to(found, (count,)).astype(np.float64)

    def factors(
        self, element: etree._Element | None, parent: etree._Element, count: int, exponents: Mapping[str, int]
    ) -> Array:
        """Return the factors (count,) that take values in the units of an element to SI units without prefixes."""
        if element is None:
            raise refused("the unit is missing here", parent, self.source)
        units = text_of(element).split()
        if len(units) not in (1, count):
            raise refused(f"{len(units)} units where 1 or {count} are expected", element, self.source)
        try:
            found = {unit: factor_to(unit, exponents) for unit in dict.fromkeys(units)}
        except DataError as error:
            raise refused(error.message, element, self.source, error.hint) from None
        return np.broadcast_to(np.array([found[unit] for unit in units]), (count,)).astype(np.float64)

    def standard_uncertainties(self, doubt: etree._Element, count: int) -> Array:
        """Return the standard uncertainties (count,) in the unit of the values. Expanded uncertainties are divided by
        their coverage factor."""
        inner = doubt
        if local_name(doubt).startswith("measurementUncertainty"):
            if len(doubt) != 1:
                raise refused("one statement of uncertainty is expected here", doubt, self.source)
            inner = doubt[0]
        kind = local_name(inner).removesuffix("XMLList")
        ending = "XMLList" if local_name(inner).endswith("XMLList") else ""
        names = _STATED.get(kind)
        if names is None:
            raise refused(f"the uncertainty '{local_name(inner)}' is not understood", inner, self.source)
        found = self.spread_over(child(inner, SI, *(name + ending for name in names)), inner, count)
        if kind in ("expandedMU", "expandedUnc"):
            factor = self.spread_over(child(inner, SI, f"coverageFactor{ending}"), inner, count)
            if factor.min() < 1.0:
                raise refused("a coverage factor is less than 1", inner, self.source)
            found = found / factor
        if found.min() < 0.0:
            raise refused("an uncertainty is negative", inner, self.source)
        return found

    def covariance(self, spread: etree._Element, count: int) -> Array:
        """Return the covariance (count, count) in SI units without prefixes, stated column by column."""
        region = spread[0] if local_name(spread).startswith("measurementUncertainty") and len(spread) else spread
        matrix = child(region, SI, "covarianceMatrixXMLList", "covarianceMatrix")
        if matrix is None:
            raise refused("the uncertainty of several values has no covariance matrix", spread, self.source)
        columns = children(matrix, SI, "columnXMLList", "column")
        if len(columns) != count:
            raise refused(f"{len(columns)} columns of the covariance where {count} are expected", matrix, self.source)
        found = np.array([self._column(column, count) for column in columns]).T
        scale = max(float(np.abs(found).max()), 1e-300)
        if np.abs(found - found.T).max() > 1e-6 * scale:
            raise refused("the covariance matrix is not symmetric", matrix, self.source)
        found = 0.5 * (found + found.T)
        if np.linalg.eigvalsh(found)[0] < -1e-6 * scale:
            raise refused("the covariance matrix is not positive semi-definite", matrix, self.source)
        return np.asarray(found)

    def _column(self, column: etree._Element, count: int) -> Array:
        """Return the column (count,): one list of values, or an element for each of them."""
        exponents = {name: 2 * power for name, power in self.exponents.items()}
        parts = []
        for one in children(column, SI, "covarianceXMLList", "covariance"):
            values = self.numbers(child(one, SI, "valueXMLList", "value"), one, None)
            parts.append(values * self.factors(child(one, SI, "unitXMLList", "unit"), one, len(values), exponents))
        found = np.concatenate(parts) if parts else np.empty(0)
        if len(found) != count:
            raise refused(f"{len(found)} covariances in a column where {count} are expected", column, self.source)
        return found


_UNIVARIATE: Final = (
    *("measurementUncertaintyUnivariate", "expandedUnc", "coverageInterval"),
    *("measurementUncertaintyUnivariateXMLList", "expandedUncXMLList", "coverageIntervalXMLList"),
)
_MULTIVARIATE: Final = (
    *("measurementUncertaintyMultivariateXMLList", "ellipsoidalRegionXMLList", "rectangularRegionXMLList"),
    *("ellipsoidalRegion", "rectangularRegion"),
)
_STATED: Final[Mapping[str, tuple[str, ...]]] = {
    "standardMU": ("valueStandardMU",),
    "expandedMU": ("valueExpandedMU",),
    "coverageIntervalMU": ("valueStandardMU",),
    "expandedUnc": ("uncertainty",),
    "coverageInterval": ("standardUnc",),
}
"""Element with the uncertainty in each statement of it; an interval states the standard uncertainty too."""
