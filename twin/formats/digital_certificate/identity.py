"""Identity of a digital calibration certificate: certified item, laboratory, number and dates."""

from __future__ import annotations

import calendar
import datetime
import re
from dataclasses import dataclass
from typing import Final

from lxml import etree

from twin.formats.digital_certificate.xml_reading import (
    DCC,
    child,
    children,
    refused,
    required,
    text_in_english,
    text_of,
)

_VALIDITY: Final = ("nextCalibrationDate", "validUntil")
_DATE: Final = re.compile(r"(\d{4}-\d{2}-\d{2})(?:Z|[+-]\d{2}:\d{2})?", re.ASCII)
_PERIOD: Final = re.compile(r"P(?:(\d{1,3})Y)?(?:(\d{1,3})M)?(?:(\d{1,4})D)?", re.ASCII)
_LONGEST: Final = 60


@dataclass(frozen=True)
class CertificateIdentity:
    """Certified item, laboratory, number and dates of a certificate.

    `until` is the end of the validity, or the date of the next calibration; it is None if the certificate states none.
    Texts that are not stated are empty.
    """

    number: str
    laboratory: str
    performed: datetime.date
    issued: datetime.date | None
    until: datetime.date | None
    item: str
    manufacturer: str
    model: str
    serial_number: str

    @property
    def text(self) -> str:
        """Certificate in one line, as an artefact file states it. What others wrote is cut, and cannot look like a
        further statement."""
        serial = [f"serial number {_short(self.serial_number)}"] if self.serial_number else []
        day = f"calibrated on {self.performed.isoformat()}"
        until = [f"valid until {self.until.isoformat()}"] if self.until is not None else []
        return ", ".join([f"{_short(self.laboratory)} {_short(self.number)}", *serial, day, *until])


def read_identity(root: etree._Element, source: str) -> CertificateIdentity:
    """Return the identity of the certificate with the root element `root`. Raise FormatError, which names `source` and
    the element, if it is not stated or cannot be understood."""
    data = required(root, source, "administrativeData")
    core = required(data, source, "coreData")
    number = required(core, source, "uniqueIdentifier")
    if not text_of(number):
        raise refused("the certificate has no number", number, source)
    items = children(required(data, source, "items"), DCC, "item")
    if len(items) != 1:
        hint = "Ask the laboratory for a certificate of the artefact alone"
        raise refused(
            f"the certificate is of {len(items)} items, and not of one", items[0] if items else data, source, hint
        )
    item = items[0]
    manufacturer = child(item, DCC, "manufacturer")
    performed = _date(required(core, source, "endPerformanceDate"), source)
    return CertificateIdentity(
        number=_line(number),
        laboratory=text_in_english(required(data, source, "calibrationLaboratory", "contact", "name")),
        performed=performed,
        issued=_optional_date(child(core, DCC, "issueDate"), source),
        until=_valid_until(data, performed, source),
        item=text_in_english(child(item, DCC, "name")),
        manufacturer="" if manufacturer is None else text_in_english(child(manufacturer, DCC, "name")),
        model=_line(child(item, DCC, "model")),
        serial_number=_serial_number(item),
    )


def _line(element: etree._Element | None) -> str:
    return " ".join(text_of(element).split())


def _serial_number(item: etree._Element) -> str:
    """Return the number by which the item is identified: that of its manufacturer, or else the first one."""
    listed = child(item, DCC, "identifications")
    found = [] if listed is None else children(listed, DCC, "identification")
    numbers = [(_line(child(one, DCC, "issuer")), _line(child(one, DCC, "value"))) for one in found]
    return next((value for issuer, value in sorted(numbers, key=lambda one: one[0] != "manufacturer")), "")


def _valid_until(data: etree._Element, performed: datetime.date, source: str) -> datetime.date | None:
    """Return the earliest date until which a statement says that the certificate is valid; None if none says it. A
    period begins with the day of the calibration."""
    listed = child(data, DCC, "statements")
    found = []
    for one in [] if listed is None else children(listed, DCC, "statement"):
        if not any(token.rpartition("_")[2] in _VALIDITY for token in one.get("refType", "").split()):
            continue
        date, period = child(one, DCC, "date"), child(one, DCC, "period")
        if date is None and period is None:
            raise refused("the statement of validity has neither a date nor a period", one, source)
        if date is not None:
            found.append(_date(date, source))
        if period is not None:
            found.append(_after(performed, period, source))
    return min(found, default=None)


def _after(day: datetime.date, period: etree._Element, source: str) -> datetime.date:
    """Return the date that is a duration such as P1Y6M after `day`."""
    text = text_of(period)
    found = _PERIOD.fullmatch(text)
    if found is None or not any(found.groups()):
        raise refused(f"'{text[:20]}' is not a period of years, months or days", period, source)
    years, months, days = (int(one or 0) for one in found.groups())
    months += 12 * years + day.month - 1
    year, month = day.year + months // 12, months % 12 + 1
    if year >= datetime.MAXYEAR:
        raise refused(f"the period '{text[:20]}' is too long", period, source)
    last = calendar.monthrange(year, month)[1]
    return datetime.date(year, month, min(day.day, last)) + datetime.timedelta(days=days)


def _optional_date(element: etree._Element | None, source: str) -> datetime.date | None:
    return None if element is None else _date(element, source)


def _date(element: etree._Element, source: str) -> datetime.date:
    text = text_of(element)
    found = _DATE.fullmatch(text)
    try:
        if found is not None:
            return datetime.date.fromisoformat(found[1])
    except ValueError:
        pass
    raise refused(f"'{text[:20]}' is not a date", element, source, "A date is written as 2026-03-01")


def _short(text: str) -> str:
    """Return the text without semicolons, which separate statements, and with at most 60 characters."""
    plain = text.replace(";", ",")
    return plain if len(plain) <= _LONGEST else f"{plain[: _LONGEST - 1]}…"
