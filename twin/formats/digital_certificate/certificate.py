"""Digital calibration certificate (DCC, schema version 3) of a ball artefact.

Every quantity of the results must be understood, or be ignored by its name: a certificate that is read in part could
leave out what matters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from lxml import etree

from twin.arrays import Array
from twin.artefact.certificate import CERTIFIED_MM, MAX_CTE_PER_K, REFERENCE_RANGE_C, BallDistance
from twin.errors import FormatError
from twin.formats.digital_certificate.dsi_units import METRE, PER_KELVIN
from twin.formats.digital_certificate.dsi_values import MAX_VALUES, DsiValues, read_celsius, read_values
from twin.formats.digital_certificate.identity import CertificateIdentity, read_identity
from twin.formats.digital_certificate.roles import AXIS_ROLES, Role, not_measured, role_of, titles
from twin.formats.digital_certificate.xml_reading import (
    DCC,
    children,
    is_named,
    local_name,
    parse_xml,
    path_of,
    refused,
    required,
    text_of,
)
from twin.units import REFERENCE_TEMPERATURE_C

ROOT = "digitalCalibrationCertificate"
_MM = 1e3
_SAME_DIAMETER_MM = 0.01
_LARGEST_M = 100.0


@dataclass(frozen=True, eq=False)
class ArtefactCertificate:
    """Content of the certificate of an artefact with N balls.

    `centres` (N, 3) are the ball centres in mm in the frame of the certificate with their `covariance` (3N, 3N) in mm²;
    both are None if the certificate states distances. `distances` are those of the other balls from ball 0, with their
    covariance `distance_covariance` (N - 1, N - 1) in mm². `ball_diameter_mm`, and `expansion` with the value and the
    standard uncertainty in 1/K, are None if they are not stated. `warnings` are what must be known of the certificate.
    """

    identity: CertificateIdentity
    centres: Array | None = field(repr=False)
    covariance: Array | None = field(repr=False)
    distances: tuple[BallDistance, ...]
    distance_covariance: Array | None = field(repr=False)
    ball_diameter_mm: float | None
    expansion: tuple[float, float] | None
    reference_temperature_c: float
    warnings: tuple[str, ...] = ()


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
    found.collect(required(root, source, "measurementResults"))
    missed = [name for name in ignored if name not in found.used]
    if missed:
        raise FormatError(f"the certificate has no result or quantity '{missed[0]}' that could be ignored", file=source)
    return found.certificate(read_identity(root, source), _warnings(root))


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
            for result in children(required(one, self.source, "results"), DCC, "result"):
                if not self._is_ignored(one) and not self._is_ignored(result):
                    self._collect_data(required(result, self.source, "data"))

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
        kind = not_measured(quantity)
        if kind is not None:
            hint = f"Pass --ignore '{kind}' if the certificate states the measured value, too"
            raise refused(f"the quantity is a '{kind}', and not what was measured", quantity, self.source, hint)
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
        values, blocks, count = list[Array](), list[Array | None](), 0
        for one in self.by_role.get(role, ()):
            part = read_values(one, METRE, self.source)
            count += len(part.values)
            if count > MAX_VALUES:
                raise refused(f"{role.value} has more than {MAX_VALUES} values", one, self.source)
            if np.abs(part.values).max() > _LARGEST_M:
                raise refused(f"a length is larger than {_LARGEST_M:g} m", one, self.source, "Check its unit")
            block = part.full_covariance
            if role is not Role.DIAMETER:
                self._check_uncertainty(one, part.values, block)
            values.append(_MM * part.values)
            blocks.append(None if block is None else _MM**2 * block)
        if not values:
            return None
        if role is Role.DIAMETER:
            return DsiValues(np.concatenate(values))
        return DsiValues(np.concatenate(values), None, _block_diagonal(blocks))

    def _check_uncertainty(self, quantity: etree._Element, values: Array, covariance: Array | None) -> None:
        """Raise FormatError if lengths (n,) in m have an uncertainty that no calibration has. Only a value of 0, which
        defines the frame, may be exact."""
        if covariance is None:
            raise refused("the values have no uncertainty", quantity, self.source, "Ask the laboratory for it")
        sigma = _MM * np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
        if sigma.max() > CERTIFIED_MM:
            told = f"a standard uncertainty is {sigma.max():.3g} mm, and that of a calibration at most {CERTIFIED_MM:g}"
            raise refused(f"{told} mm", quantity, self.source, "Check its unit, and that of the values")
        if (sigma[values != 0.0] <= 0.0).any():
            raise refused("a standard uncertainty is 0", quantity, self.source, "Ask the laboratory for it")

    def certificate(self, identity: CertificateIdentity, warnings: tuple[str, ...]) -> ArtefactCertificate:
        centres, covariance = self._centres()
        distances, together = self._distances()
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
            identity,
            centres,
            covariance,
            distances,
            together,
            self._diameter(),
            self._expansion(),
            self._reference(),
            warnings,
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
        if 3 * count > MAX_VALUES:
            raise self._of(AXIS_ROLES, f"{count} balls are more than {MAX_VALUES // 3}")
        # from axis by axis to ball by ball
        order = np.arange(3 * count).reshape(3, count).T.reshape(-1)
        covariance = _block_diagonal([one.covariance for one in stated])
        return np.stack([one.values for one in stated], axis=1), covariance[np.ix_(order, order)]

    def _distances(self) -> tuple[tuple[BallDistance, ...], Array | None]:
        """Return the distances of the balls 1, 2, … from ball 0, and their covariance (N - 1, N - 1) in mm²."""
        found = self._lengths(Role.DISTANCES)
        if found is None or found.covariance is None:
            return (), None
        left = 1 if found.values[0] == 0.0 else 0  # the distance of ball 0 from itself
        covariance = found.covariance[left:, left:]
        sigma = np.sqrt(np.diagonal(covariance))
        distances = []
        for ball, (length, doubt) in enumerate(zip(found.values[left:].tolist(), sigma.tolist(), strict=True), start=1):
            if not (length > 0.0 and doubt > 0.0):
                raise self._of((Role.DISTANCES,), f"the distance of ball {ball} or its uncertainty is not positive")
            distances.append(BallDistance((0, ball), length, doubt))
        return tuple(distances), covariance

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
        value, doubt = float(found.values[0]), float(np.sqrt(found.full_covariance[0, 0]))
        if abs(value) > MAX_CTE_PER_K or not 0.0 < doubt <= MAX_CTE_PER_K:
            told = f"the thermal expansion is {value:.3g} 1/K with a standard uncertainty of {doubt:.3g} 1/K"
            hint = f"Both are at most {MAX_CTE_PER_K:g} 1/K, and none is exact: check the unit"
            raise refused(told, quantity, self.source, hint)
        return value, doubt

    def _reference(self) -> float:
        if Role.REFERENCE_TEMPERATURE not in self.by_role:
            return REFERENCE_TEMPERATURE_C
        quantity = self._single(Role.REFERENCE_TEMPERATURE)
        found = read_celsius(quantity, self.source)
        low, high = REFERENCE_RANGE_C
        if not low <= found <= high:
            told = f"the reference temperature is {found:.6g} °C"
            raise refused(told, quantity, self.source, f"It lies between {low:g} and {high:g} °C: check its unit")
        return found

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


def _warnings(root: etree._Element) -> tuple[str, ...]:
    """Return what a certificate states against itself."""
    found = []
    for one in root.iter(f"{{{DCC}}}conformity"):
        if text_of(one) not in ("pass", ""):
            found.append(f"The certificate states the conformity '{text_of(one)[:20]}' ({path_of(one)}).")
            break
    amended = next(root.iter(f"{{{DCC}}}reportAmendedSubstituted"), None)
    if amended is not None:
        found.append("The certificate amends or substitutes another one: make sure that it is the last one.")
    return tuple(found)


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
