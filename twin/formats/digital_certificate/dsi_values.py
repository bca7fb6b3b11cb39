"""Values of a quantity in D-SI with their uncertainties, in the current form of the schema (2.2) and in the form that
it replaces (1.3 to 2.1)."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from statistics import NormalDist
from typing import Final

import numpy as np
from lxml import etree

from twin.arrays import Array
from twin.errors import DataError, FormatError
from twin.formats.digital_certificate.dsi_units import DEGREE_CELSIUS, factor_to
from twin.formats.digital_certificate.xml_reading import (
    DCC,
    SI,
    child,
    children,
    is_named,
    local_name,
    refuse_loose_text,
    refused,
    text_of,
)

VALUES: Final = ("real", "realListXMLList", "hybrid")
"""Elements of D-SI that can be read."""

MAX_VALUES: Final = 300
"""Number of values of one quantity at most: three coordinates of a hundred balls."""

# decimal numbers of XML Schema, without NaN and infinity
_NUMBER: Final = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d{1,3})?")
_CONTRADICTION: Final = 0.05  # a covariance and an uncertainty of the same value that differ by more are not the same

_TOO_LARGE: Final = 1e30  # no quantity of an artefact; squares of it are still finite
_LARGEST_COVERAGE: Final = 10.0
_COVERAGE_MISFIT: Final = 0.15  # laboratories round k = 2 and p = 95 %
_RECTANGULAR: Final = {"rectangular", "uniform"}
_BESIDE: Final = (
    *("name", "description", "usedMethods", "usedSoftware", "measuringEquipments", "influenceConditions"),
    "measurementMetaData",
)
"""Parts of a quantity beside its value that do not change it."""


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
    found = _stated(quantity, source)
    if is_named(found, SI, "hybrid"):
        first = child(found, SI, *VALUES[:2])
        if first is None:
            raise _nothing(found, source)
        found = first
    return _Reader(source, exponents).values(found)


def read_celsius(quantity: etree._Element, source: str) -> float:
    r"""Return the temperature of a `dcc:quantity` in °C, which is stated in `\degreecelsius` or `\kelvin`. Raise
    FormatError as `read_values` does."""
    found = _stated(quantity, source)
    if is_named(found, SI, "real") and text_of(child(found, SI, "unit")) == DEGREE_CELSIUS:
        reader = _Reader(source, {})
        reader.check_parts(found, "")
        (value,) = reader.numbers(child(found, SI, "value"), found, 1)
        return float(value)
    values = read_values(quantity, {"kelvin": 1}, source).values
    if len(values) != 1:
        raise refused(f"{len(values)} temperatures where one is expected", quantity, source)
    return float(values[0]) - 273.15


def _stated(quantity: etree._Element, source: str) -> etree._Element:
    """Return the element with the values of a `dcc:quantity`. Raise FormatError if there is not exactly one, or if the
    quantity has parts that could change its meaning."""
    found = []
    for one in quantity:
        if is_named(one, SI, *VALUES):
            found.append(one)
        elif is_named(one, DCC, "relativeUncertainty"):
            raise refused("a relative uncertainty is not understood", one, source, "State it in the unit of the value")
        elif not is_named(one, DCC, *_BESIDE):
            raise refused(f"the element {local_name(one)} of a quantity is not understood", one, source)
    refuse_loose_text(quantity, source)
    if not found:
        raise _nothing(quantity, source)
    if len(found) > 1:
        raise refused("the quantity states its value twice", found[1], source)
    return found[0]


def _nothing(element: etree._Element, source: str) -> FormatError:
    kinds = " or ".join(f"si:{name}" for name in VALUES)
    return refused("the quantity has no value that is understood", element, source, f"It needs {kinds}")


@dataclass(frozen=True)
class _Reader:
    source: str
    exponents: Mapping[str, int]

    def values(self, found: etree._Element) -> DsiValues:
        ending = "XMLList" if is_named(found, SI, "realListXMLList") else ""
        self.check_parts(found, ending)
        values = self.numbers(child(found, SI, f"value{ending}"), found, None if ending else 1)
        factors = self.factors(child(found, SI, f"unit{ending}"), found, len(values), self.exponents)
        doubt, spread = child(found, SI, *_UNIVARIATE), child(found, SI, *_MULTIVARIATE)
        sigma = None if doubt is None else self.standard_uncertainties(doubt, len(values))
        covariance = None if spread is None else self.covariance(spread, len(values))
        sigma = None if sigma is None else self._scaled(sigma, np.abs(factors), found)
        if spread is not None and covariance is not None and sigma is not None:
            stated = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
            if np.abs(stated - sigma).max() > _CONTRADICTION * max(float(sigma.max()), 1e-300):
                raise refused("the covariance contradicts the uncertainties of the same values", spread, self.source)
        return DsiValues(self._scaled(values, factors, found), sigma, covariance)

    def check_parts(self, found: etree._Element, ending: str) -> None:
        """Raise FormatError if a `si:real` or a list (`ending` is XMLList) has an unknown part, or one part twice."""
        known = {
            "label", "labelXMLList", "quantityTypeQUDT", "quantityTypeQUDTXMLList", f"value{ending}", f"unit{ending}",
            "significantDigit", "significantDigitXMLList", "dateTime", "dateTimeXMLList", *_UNIVARIATE, *_MULTIVARIATE,
        }  # fmt: skip
        names = set()
        for one in found:
            if not is_named(one, SI, *known):
                raise refused(f"the element {local_name(one)} of a quantity is not understood", one, self.source)
            if one.tag in names:
                raise refused(f"the element {local_name(one)} of a quantity is stated twice", one, self.source)
            names.add(one.tag)
        refuse_loose_text(found, self.source)

    def _scaled(self, numbers: Array, factors: Array, element: etree._Element) -> Array:
        """Return the numbers times the factors of their units. Raise FormatError if a product is too large."""
        with np.errstate(over="ignore", invalid="ignore"):
            found = numbers * factors
        if not np.abs(found).max() < _TOO_LARGE:
            raise refused("a number is too large for what it states", element, self.source, "Check its unit")
        return np.asarray(found)

    def numbers(self, element: etree._Element | None, parent: etree._Element, count: int | None) -> Array:
        """Return the numbers (n,) in the text of an element of `parent`, which are `count` unless that is None."""
        if element is None:
            raise refused("a number is missing here", parent, self.source)
        if len(element):
            raise refused("only numbers are expected here", element[0], self.source)
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
        if len(element):
            raise refused("only units are expected here", element[0], self.source)
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
            if factor.max() > _LARGEST_COVERAGE:
                raise refused(f"a coverage factor is larger than {_LARGEST_COVERAGE:g}", inner, self.source)
            self._check_coverage(inner, ending, factor)
            found = found / factor
        if found.min() < 0.0:
            raise refused("an uncertainty is negative", inner, self.source)
        return found

    def _check_coverage(self, inner: etree._Element, ending: str, factor: Array) -> None:
        """Raise FormatError if a coverage probability is none, or contradicts the coverage factor (n,). Fewer degrees
        of freedom make the factor larger than that of a normal distribution, never smaller."""
        stated = child(inner, SI, f"coverageProbability{ending}")
        if stated is None:
            return
        probability = self.spread_over(stated, inner, len(factor))
        kinds = {one.casefold() for one in text_of(child(inner, SI, f"distribution{ending}")).split()}
        if not (probability.min() > 0.0 and probability.max() < 1.0):
            raise refused("a coverage probability is not between 0 and 1", stated, self.source)
        normal = np.array([NormalDist().inv_cdf(0.5 + 0.5 * one) for one in probability.tolist()])
        if kinds & _RECTANGULAR:
            wrong = np.abs(factor / (math.sqrt(3.0) * probability) - 1.0) > _COVERAGE_MISFIT
        elif "normal" in kinds:
            wrong = np.abs(factor / normal - 1.0) > _COVERAGE_MISFIT
        else:
            wrong = factor < (1.0 - _COVERAGE_MISFIT) * normal if not kinds else np.zeros(len(factor), dtype=bool)
        if wrong.any():
            told = f"the coverage factor {factor[wrong][0]:g} contradicts the coverage probability"
            raise refused(f"{told} {probability[wrong][0]:g}", stated, self.source, "Ask the laboratory which is right")

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
            factors = self.factors(child(one, SI, "unitXMLList", "unit"), one, len(values), exponents)
            parts.append(self._scaled(values, factors, one))
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
