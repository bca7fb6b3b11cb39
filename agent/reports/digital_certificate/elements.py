"""Elements of a digital calibration certificate: texts in two languages, and quantities in D-SI."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final

from lxml import etree

from agent.language.sentences import german, without_marks
from agent.printable import one_line
from agent.results.facts import Quantity
from twin.formats.digital_certificate.xml_reading import DCC, SI

SCHEMA_VERSION: Final = "3.3.0"
LANGUAGES: Final = ("en", "de")
UNITS: Final = {"µm": r"\micro\metre", "µrad": r"\micro\radian", "°C": r"\degreecelsius"}
"""D-SI of the units of reports."""
COVERAGE_FACTOR, COVERAGE_PROBABILITY = "2", "0.95"

_INSTANCE: Final = "http://www.w3.org/2001/XMLSchema-instance"
_LONGEST: Final = 20_000
_LONGEST_REMARK: Final = 200
_DECIMALS: Final = 4


def new_root() -> etree._Element:
    """Return the empty root element of a certificate, which names its schema."""
    names = {"dcc": DCC, "si": SI, "xsi": _INSTANCE}
    root = etree.Element(f"{{{DCC}}}digitalCalibrationCertificate", schemaVersion=SCHEMA_VERSION, nsmap=names)
    root.set(f"{{{_INSTANCE}}}schemaLocation", f"{DCC} {DCC}/v{SCHEMA_VERSION}/dcc.xsd")
    return root


def add(parent: etree._Element, name: str, text: str | None = None, **attributes: str) -> etree._Element:
    """Add the element `name` to `parent` and return it. Its text is made one line of printable characters."""
    element = etree.SubElement(parent, f"{{{DCC}}}{name}", attrib=attributes)
    if text is not None:
        element.text = _plain(text)
    return element


def add_words(parent: etree._Element, name: str, *sentences: str, **attributes: str) -> etree._Element:
    """Add an element with sentences of the program, which make one text in English and one in German. If a text would
    be too long, the last sentences are left out, and their number is stated."""
    shown = list(sentences)
    while sum(max(len(one), len(german(one))) + 2 for one in shown) > _LONGEST - _LONGEST_REMARK and len(shown) > 1:
        shown.pop()
    left_out = len(sentences) - len(shown)
    if left_out:
        shown.append(f"{left_out} further notes are left out here; they are in the report of the run.")
    element = add(parent, name, **attributes)
    for language in LANGUAGES:
        told = (sentence if language == "en" else german(sentence) for sentence in shown)
        add(element, "content", " ".join(_ended(one) if len(shown) > 1 else one for one in told), lang=language)
    return element


def add_translated(parent: etree._Element, name: str, texts: Mapping[str, str]) -> etree._Element:
    """Add an element with one text for each language."""
    element = add(parent, name)
    for language in LANGUAGES:
        add(element, "content", texts[language], lang=language)
    return element


def _ended(sentence: str) -> str:
    """Return the sentence with a full stop at its end."""
    return sentence if sentence.endswith((".", "!", "?")) else f"{sentence}."


def add_said(parent: etree._Element, name: str, text: str, **attributes: str) -> etree._Element:
    """Add an element with the words of a person or a name, which have no language."""
    element = add(parent, name, **attributes)
    add(element, "content", text)
    return element


def add_identifications(parent: etree._Element, numbers: Iterable[tuple[str, str, str]]) -> None:
    """Add the list of numbers that identify an item: issuer, number, and what it is. Nothing is added without any."""
    known = [one for one in numbers if one[1]]
    if not known:
        return
    listed = add(parent, "identifications")
    for issuer, value, meaning in known:
        reference = {"refType": "basic_serialNumber"} if meaning == "serial number" else {}
        one = add(listed, "identification", **reference)
        add(one, "issuer", issuer)
        add(one, "value", value)
        add_words(one, "name", meaning)


def add_software(parent: etree._Element, version: str) -> None:
    """Add this program with its version."""
    software = add(parent, "software")
    add_said(software, "name", "volcal")
    add(software, "release", f"v{version}")
    add(software, "type", "application")


def add_real(
    parent: etree._Element,
    value: float,
    unit: str,
    expanded: float | None = None,
    limits: Quantity | None = None,
    *,
    is_normal: bool = True,
) -> None:
    """Add a value with its unit (a key of UNITS).

    Its uncertainty is `expanded` (k = 2), or the 95 % limits and the standard uncertainty of `limits`. It has none if
    both are None. `is_normal` is False for a value whose distribution is not normal, such as a range.
    """
    real = _si(parent, "real")
    _si(real, "value", _number(value))
    _si(real, "unit", UNITS[unit])
    if limits is not None and limits.limits_um is not None and limits.standard_uncertainty_um is not None:
        interval = _si(_si(real, "measurementUncertaintyUnivariate"), "coverageIntervalMU")
        _si(interval, "valueStandardMU", _number(limits.standard_uncertainty_um))
        _si(interval, "intervalMin", _number(limits.limits_um[0]))
        _si(interval, "intervalMax", _number(limits.limits_um[1]))
        _si(interval, "coverageProbability", COVERAGE_PROBABILITY)
    elif expanded is not None:
        doubt = _si(_si(real, "measurementUncertaintyUnivariate"), "expandedMU")
        _si(doubt, "valueExpandedMU", _number(expanded))
        _si(doubt, "coverageFactor", COVERAGE_FACTOR)
        _si(doubt, "coverageProbability", COVERAGE_PROBABILITY)
        if is_normal:
            _si(doubt, "distribution", "normal")


def _si(parent: etree._Element, name: str, text: str | None = None) -> etree._Element:
    element = etree.SubElement(parent, f"{{{SI}}}{name}")
    element.text = text
    return element


def _number(value: float) -> str:
    return f"{round(value, _DECIMALS) + 0.0:.{_DECIMALS}f}"


def _plain(text: str) -> str:
    return one_line(without_marks(text), _LONGEST)
