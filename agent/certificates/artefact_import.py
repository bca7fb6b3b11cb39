"""Import of the digital calibration certificate of an artefact into an artefact file."""

from __future__ import annotations

import datetime
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from agent.certificates.xml_signature import CheckedDocument, Trust, check_signature
from agent.files import translated
from agent.model_files import load_artefact
from agent.printable import one_line
from drivers.errors import InputError
from drivers.foreign_errors import cause_of
from twin.artefact.artefact import Artefact
from twin.formats.artefact_file import format_artefact, parse_artefact
from twin.formats.digital_certificate.certificate import ArtefactCertificate, parse_certificate
from twin.formats.digital_certificate.certified_artefact import certified_artefact
from twin.formats.digital_certificate.xml_reading import MAX_BYTES
from twin.units import UM_PER_MM

_LONGEST = 600
_LONGEST_NAME = 80
_COMPARED = ("ball_diameter_mm", "cte_per_k", "cte_standard_uncertainty_per_k", "reference_temperature_c")


@dataclass(frozen=True)
class ImportRequest:
    """Request to write the certificate in `file` as the artefact file `out`. The artefact file `like` states the rest.
    Names in `ignored` are not read; `trusted` are files with certificates of signers."""

    file: Path
    like: Path
    out: Path
    ignored: tuple[str, ...] = ()
    trusted: tuple[Path, ...] = ()


@dataclass(frozen=True, eq=False)
class ImportedArtefact:
    """Artefact with the values of a certificate, the texts of its files by their names, and what must be known of it.

    `changes` are the other values that differ from those of the artefact file before, by their keys in it, each with
    the value before and after. `moved_mm` is the largest distance of a ball from where it was in that file.
    """

    artefact: Artefact
    certificate: ArtefactCertificate
    document: CheckedDocument
    files: Mapping[str, str]
    warnings: tuple[str, ...]
    changes: tuple[tuple[str, float, float], ...]
    moved_mm: float

    @property
    def largest_uncertainty_um(self) -> float:
        """Largest standard uncertainty in µm of a coordinate."""
        return float(UM_PER_MM * np.sqrt(np.diagonal(self.artefact.covariance).max()))

    def as_json(self) -> dict[str, Any]:
        """Return the JSON object that docs/reference/json.md describes."""
        identity = self.certificate.identity
        return {
            "artefact": self.artefact.name,
            "certificate": self.artefact.certificate,
            "number": identity.number,
            "laboratory": identity.laboratory,
            "serial_number": identity.serial_number,
            "performed": identity.performed.isoformat(),
            "valid_until": None if identity.until is None else identity.until.isoformat(),
            "signature": self.document.trust.name.lower(),
            "signer": self.document.signer,
            "balls": self.artefact.count,
            "largest_standard_uncertainty_um": self.largest_uncertainty_um,
            "largest_change_mm": self.moved_mm,
            "changes": {key: {"before": before, "after": after} for key, before, after in self.changes},
            "warnings": list(self.warnings),
        }


def import_certificate(request: ImportRequest, today: datetime.date) -> ImportedArtefact:
    """Return the artefact of a certificate. `today` tells whether it is still valid.

    Raises InputError if the certificate cannot be read in full, is not of this artefact, or is not signed as `trusted`
    demands.
    """
    source = str(request.file)
    document = check_signature(_read(request.file), source, request.trusted)
    like = load_artefact(request.like)
    with translated(InputError, file=source):
        certificate = parse_certificate(document.content, source, request.ignored)
        # the state of the signature first: nothing that others wrote can push it out or stand in its place
        origin = one_line(f"{document.text}; {certificate.identity.text}", _LONGEST)
        artefact = certified_artefact(certificate, like, origin)
    outside = _outside_validity(certificate, document)
    if outside and document.trust is Trust.TRUSTED:
        raise InputError(outside, hint="ask the laboratory for the certificate with a valid signature", file=source)
    covariance_file = f"{request.out.stem}-covariance.csv"
    notes = (
        f"Imported from the digital calibration certificate {one_line(request.file.name, _LONGEST_NAME)}.",
        "What it does not state is that of the artefact file before. Standard uncertainties; U = 2 u.",
    )
    texts = format_artefact(artefact, covariance_file, notes)
    with translated(InputError, certificate=source):
        parse_artefact(texts[0], str(request.out), lambda _: texts[1])  # what is written must be readable
    return ImportedArtefact(
        artefact,
        certificate,
        document,
        dict(zip((request.out.name, covariance_file), texts, strict=True)),
        tuple(_warnings(certificate, document, today)),
        tuple(_changes(artefact, like)),
        float(np.linalg.norm(artefact.balls - like.balls, axis=1).max()),
    )


def _changes(artefact: Artefact, like: Artefact) -> Iterator[tuple[str, float, float]]:
    """Yield the key in the artefact file, the value before and the value after for each that differs."""
    for key in _COMPARED:
        before, after = (float(getattr(one, key)) for one in (like, artefact))
        if before != after:
            yield key, before, after


def _outside_validity(certificate: ArtefactCertificate, document: CheckedDocument) -> str:
    """Return what is wrong if the signature must have been made after the signer's certificate had expired."""
    day = certificate.identity.issued or certificate.identity.performed
    if document.valid is None or day <= document.valid[1]:
        return ""
    return (
        f"the certificate is dated {day.isoformat()}, and that of its signer has expired on "
        f"{document.valid[1].isoformat()}"
    )


def _read(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(MAX_BYTES + 1)
    except FileNotFoundError:
        raise InputError("there is no such file", hint="check the path", file=str(path)) from None
    except OSError as cause:
        raise InputError(f"the file cannot be read: {cause_of(cause)}", file=str(path)) from None


def _warnings(certificate: ArtefactCertificate, document: CheckedDocument, today: datetime.date) -> Sequence[str]:
    warnings = []
    if document.trust is Trust.UNSIGNED:
        warnings.append(
            "The certificate is NOT SIGNED: anybody could have written or changed it. Compare it with the one that the "
            "laboratory sent."
        )
    if document.trust is Trust.UNKNOWN_SIGNER:
        warnings.append(
            "The signature is intact, but the SIGNER IS NOT CHECKED: anybody could have signed it. Pass the "
            f"certificate of the laboratory with --trusted. Signed by {document.signer}"
        )
    outside = _outside_validity(certificate, document)
    if outside:
        warnings.append(f"{outside[0].upper()}{outside[1:]}.")
    warnings += certificate.warnings
    until = certificate.identity.until
    if until is not None and until < today:
        warnings.append(f"The validity of the certificate ended on {until.isoformat()}.")
    if certificate.identity.performed > today:
        warnings.append(f"The certificate is dated after today: {certificate.identity.performed.isoformat()}.")
    return warnings
