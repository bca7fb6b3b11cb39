"""Digital calibration certificate (DCC, schema version 3) of a ball artefact.

Every quantity of the results must be understood, or be ignored by its name: a certificate that is read in part could
leave out what matters.
"""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from lxml import etree

from twin.arrays import Array
from twin.artefact.certificate import BallDistance
from twin.errors import FormatError
from twin.formats.digital_certificate.dsi_units import METRE, PER_KELVIN
from twin.formats.digital_certificate.dsi_values import DsiValues, read_celsius, read_values
from twin.formats.digital_certificate.roles import AXIS_ROLES, Role, role_of, titles
from twin.formats.digital_certificate.xml_reading import (
    DCC,
    child,
    children,
    is_named,
    local_name,
    parse_xml,
    path_of,
    refused,
    text_in_english,
    text_of,
)
from twin.units import REFERENCE_TEMPERATURE_C

ROOT = "digitalCalibrationCertificate"
_MM = 1e3
_SAME_DIAMETER_MM = 0.01
_VALIDITY = ("nextCalibrationDate", "validUntil")


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
        """Certificate in one line, as an artefact file states it."""
        serial = [f"serial number {self.serial_number}"] if self.serial_number else []
        day = f"calibrated on {self.performed.isoformat()}"
        until = [f"valid until {self.until.isoformat()}"] if self.until is not None else []
        return ", ".join([f"{self.laboratory} {self.number}", *serial, day, *until])


@dataclass(frozen=True, eq=False)
class ArtefactCertificate:
    """Content of the certificate of an artefact with N balls.

    `centres` (N, 3) are the ball centres in mm in the frame of the certificate with their `covariance` (3N, 3N) in mm²;
    both are None if the certificate states distances. `distances` are those of the other balls from ball 0, not
    correlated. `ball_diameter_mm`, and `expansion` with the value and the standard uncertainty in 1/K, are None if they
    are not stated.
    """

    identity: CertificateIdentity
    centres: Array | None = field(repr=False)
    covariance: Array | None = field(repr=False)
    distances: tuple[BallDistance, ...]
    ball_diameter_mm: float | None
    expansion: tuple[float, float] | None
    reference_temperature_c: float


def parse_certificate(content: bytes, source: str, ignored: Sequence[str] = ()) -> ArtefactCertificate:
    """Return the content of a certificate.

    `ignored` are names, identities or `refType`s of results and quantities that are not read. Raise FormatError, which
    names `source` and the element, if anything else cannot be understood.
    """
    root = parse_xml(content, source)
    if not is_named(root, DCC, ROOT):
        raise refused(
            f"this is no digital calibration certificate: its root is '{local_name(root)}'",
            root,
            source,
            f"Its root must be '{ROOT}' in the namespace {DCC}",
        )
    version = root.get("schemaVersion", "")
    if not version.startswith("3."):
        raise refused(
            f"schema version '{version[:20]}' of the certificate is not understood",
            root,
            source,
            "Ask the laboratory for a certificate of version 3",
        )
    found = _Found(source, tuple(ignored), set(), {})
    found.collect(_required(root, source, "measurementResults"))
    missed = [name for name in ignored if name not in found.used]
    if missed:
        raise FormatError(f"the certificate has no result or quantity '{missed[0]}' that could be ignored", file=source)
    return found.certificate(_identity(root, source))


@dataclass(frozen=True)
class _Found:
    """Quantities of a certificate by their role, as they are collected."""

    source: str
    ignored: tuple[str, ...]
    used: set[str]
    by_role: dict[Role, list[etree._Element]]

    def _is_ignored(self, element: etree._Element) -> bool:
        named = set(titles(element)) & set(self.ignored)
        self.used.update(named)
        return bool(named)

    def collect(self, results: etree._Element) -> None:
        measured = children(results, DCC, "measurementResult")
        if not measured:
            raise refused("the certificate has no results", results, self.source)
        for one in measured:
            for result in children(_required(one, self.source, "results"), DCC, "result"):
                if not self._is_ignored(one) and not self._is_ignored(result):
                    self._collect_data(_required(result, self.source, "data"))

    def _collect_data(self, data: etree._Element) -> None:
        for one in data:
            if is_named(one, DCC, "list"):
                if not self._is_ignored(one):
                    self._collect_data(one)
            elif is_named(one, DCC, "quantity"):
                if not self._is_ignored(one):
                    self._add(one)
            elif not is_named(one, DCC, *_PASSED):
                hint = "Ignore the result that contains it by its name, if the artefact does not need it"
                raise refused(f"the element {local_name(one)} of a result is not understood", one, self.source, hint)

    def _add(self, quantity: etree._Element) -> None:
        role = role_of(quantity)
        if role is None:
            named = titles(quantity)
            said = f"'{named[0][:60]}'" if named else "without a name"
            raise refused(
                f"the quantity {said} is not understood",
                quantity,
                self.source,
                "Ignore it by its name if the artefact does not need it, or ask the laboratory for one of the refTypes "
                f"{', '.join(role.value for role in Role)}",
            )
        before = self.by_role.setdefault(role, [])
        if before and _result_of(before[0]) is not _result_of(quantity):
            raise refused(
                f"{role.value} is stated by two results, also by {path_of(before[0])}",
                quantity,
                self.source,
                "Ignore one of the two results by its name, for example the values before an adjustment",
            )
        before.append(quantity)

    def _lengths(self, role: Role) -> DsiValues | None:
        """Return the values of all quantities of a role, one after the other, in mm; None if there are none."""
        parts = [(one, read_values(one, METRE, self.source)) for one in self.by_role.get(role, ())]
        if not parts:
            return None
        for one, part in parts:
            if part.full_covariance is None and role is not Role.DIAMETER:
                raise refused("the values have no uncertainty", one, self.source, "Ask the laboratory for it")
        values = np.concatenate([part.values for _, part in parts])
        if role is Role.DIAMETER:
            return DsiValues(_MM * values)
        return DsiValues(_MM * values, None, _MM**2 * _block_diagonal([part.full_covariance for _, part in parts]))

    def certificate(self, identity: CertificateIdentity) -> ArtefactCertificate:
        centres, covariance = self._centres()
        distances = self._distances()
        if (centres is None) == (not distances):
            raise FormatError(
                "the certificate states neither ball centres nor distances"
                if centres is None
                else "the certificate states both ball centres and distances",
                hint="Ignore the distances by their name"
                if centres is not None
                else f"It needs a quantity with the refType {Role.CENTRES.value} or {Role.DISTANCES.value}",
                file=self.source,
            )
        return ArtefactCertificate(
            identity, centres, covariance, distances, self._diameter(), self._expansion(), self._reference()
        )

    def _centres(self) -> tuple[Array | None, Array | None]:
        whole = self._lengths(Role.CENTRES)
        axes = [self._lengths(role) for role in AXIS_ROLES]
        stated = [one for one in axes if one is not None]
        if whole is not None and stated:
            raise self._of(AXIS_ROLES, "the ball centres are stated twice, also by single coordinates")
        if whole is not None:
            if len(whole.values) % 3 or len(whole.values) < 6:
                raise self._of((Role.CENTRES,), f"{len(whole.values)} coordinates are not those of two balls or more")
            return whole.values.reshape(-1, 3), whole.covariance
        if not stated:
            return None, None
        if len(stated) < 3 or len({len(one.values) for one in stated}) > 1 or len(stated[0].values) < 2:
            counts = ", ".join(str(0 if one is None else len(one.values)) for one in axes)
            raise self._of(AXIS_ROLES, f"the numbers of X, Y and Z coordinates differ or are less than 2: {counts}")
        count = len(stated[0].values)
        # from axis by axis to ball by ball
        order = np.arange(3 * count).reshape(3, count).T.reshape(-1)
        covariance = _block_diagonal([one.covariance for one in stated])
        return np.stack([one.values for one in stated], axis=1), covariance[np.ix_(order, order)]

    def _distances(self) -> tuple[BallDistance, ...]:
        found = self._lengths(Role.DISTANCES)
        if found is None or found.covariance is None:
            return ()
        sigma = np.sqrt(np.diagonal(found.covariance))
        first = 0 if found.values[0] == 0.0 else 1
        distances = []
        for ball, (length, doubt) in enumerate(zip(found.values.tolist(), sigma.tolist(), strict=True), start=first):
            if ball == 0:
                continue
            if not (length > 0.0 and doubt > 0.0):
                raise self._of((Role.DISTANCES,), f"the distance of ball {ball} or its uncertainty is not positive")
            distances.append(BallDistance((0, ball), length, doubt))
        return tuple(distances)

    def _diameter(self) -> float | None:
        found = self._lengths(Role.DIAMETER)
        if found is None:
            return None
        if np.ptp(found.values) > _SAME_DIAMETER_MM or found.values.min() <= 0.0:
            raise self._of((Role.DIAMETER,), "the balls differ in diameter by more than 0.01 mm")
        return float(found.values.mean())

    def _expansion(self) -> tuple[float, float] | None:
        if Role.EXPANSION not in self.by_role:
            return None
        quantity = self._single(Role.EXPANSION)
        found = read_values(quantity, PER_KELVIN, self.source)
        if len(found.values) != 1 or found.full_covariance is None:
            raise refused("one value with its uncertainty is expected here", quantity, self.source)
        return float(found.values[0]), float(np.sqrt(found.full_covariance[0, 0]))

    def _reference(self) -> float:
        if Role.REFERENCE_TEMPERATURE not in self.by_role:
            return REFERENCE_TEMPERATURE_C
        return read_celsius(self._single(Role.REFERENCE_TEMPERATURE), self.source)

    def _single(self, role: Role) -> etree._Element:
        first, *others = self.by_role[role]
        if others:
            raise refused(f"{role.value} is stated twice", others[0], self.source)
        return first

    def _of(self, roles: Sequence[Role], message: str) -> FormatError:
        first = next(one for role in roles for one in self.by_role.get(role, ()))
        return refused(message, first, self.source)


_PASSED = (
    *("name", "description", "text", "dateTime", "dateTimeXMLList", "usedMethods", "usedSoftware"),
    *("measuringEquipments", "influenceConditions", "measurementMetaData"),
)
"""Parts of results that do not change the values."""


def _result_of(element: etree._Element) -> etree._Element | None:
    return next(element.iterancestors(f"{{{DCC}}}result"), None)


def _block_diagonal(blocks: Sequence[Array | None]) -> Array:
    """Return the matrix with the blocks on its diagonal."""
    sizes = [0 if block is None else len(block) for block in blocks]
    whole, at = np.zeros((sum(sizes), sum(sizes))), 0
    for block, size in zip(blocks, sizes, strict=True):
        if block is not None:
            whole[at : at + size, at : at + size] = block
        at += size
    return whole


def _required(parent: etree._Element, source: str, *names: str) -> etree._Element:
    """Return the descendant of `parent` that the names lead to, level by level."""
    at = parent
    for name in names:
        found = child(at, DCC, name)
        if found is None:
            raise refused(f"the certificate has no element '{name}' here", at, source)
        at = found
    return at


def _identity(root: etree._Element, source: str) -> CertificateIdentity:
    data = _required(root, source, "administrativeData")
    core = _required(data, source, "coreData")
    number = _required(core, source, "uniqueIdentifier")
    if not text_of(number):
        raise refused("the certificate has no number", number, source)
    items = children(_required(data, source, "items"), DCC, "item")
    if len(items) != 1:
        hint = "Ask the laboratory for a certificate of the artefact alone"
        raise refused(
            f"the certificate is of {len(items)} items, and not of one", items[0] if items else data, source, hint
        )
    item = items[0]
    manufacturer = child(item, DCC, "manufacturer")
    performed = _required(core, source, "endPerformanceDate")
    return CertificateIdentity(
        number=_line(number),
        laboratory=text_in_english(_required(data, source, "calibrationLaboratory", "contact", "name")),
        performed=_date(performed, source),
        issued=_optional_date(child(core, DCC, "issueDate"), source),
        until=_valid_until(data, source),
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


def _valid_until(data: etree._Element, source: str) -> datetime.date | None:
    """Return the date until which a statement says that the certificate is valid; None if none says it."""
    listed = child(data, DCC, "statements")
    for one in [] if listed is None else children(listed, DCC, "statement"):
        if any(token.rpartition("_")[2] in _VALIDITY for token in one.get("refType", "").split()):
            return _optional_date(child(one, DCC, "date"), source)
    return None


def _optional_date(element: etree._Element | None, source: str) -> datetime.date | None:
    return None if element is None else _date(element, source)


def _date(element: etree._Element, source: str) -> datetime.date:
    text = text_of(element)
    try:
        return datetime.date.fromisoformat(text[:10])
    except ValueError:
        raise refused(f"'{text[:20]}' is not a date", element, source) from None
