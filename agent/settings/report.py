"""Section `[report]` of the settings file: language of the report, head of the document, instruments and tolerances."""

from __future__ import annotations

from datetime import date
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, PositiveFloat, StringConstraints, model_validator

from twin.formats.toml_reading import StrictModel

# printable characters of one line; neither control characters nor invisible ones (soft hyphen, zero width) nor marks of
# the writing direction (U+061C is the Arabic one)
Words = Annotated[
    str,
    StringConstraints(
        strip_whitespace=True,
        min_length=1,
        max_length=120,
        pattern=r"^[^\x00-\x1f\x7f-\x9f\xad\u061c\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff]+$",
    ),
]
Tolerated = Annotated[str, Field(pattern=r"^(E[XYZABC][XYZ]|A0Z|B0Z|C0Y|VE|VCE)$")]
InstrumentKind = Literal["probe", "sensor", "artefact", "thermometer", "other"]


class MachineIdentity(StrictModel):
    """Machine as its type plate names it."""

    maker: Words | None = None
    model: Words | None = None
    serial_number: Words | None = None


class Instrument(StrictModel):
    """Instrument that was used, with its certificate of calibration. `calibrated` is the date of the calibration, and
    `due` the date of the next one."""

    kind: InstrumentKind
    name: Words | None = None
    serial_number: Words | None = None
    certificate: Words | None = None
    calibrated: date | None = None
    due: date | None = None

    @model_validator(mode="after")
    def _due_after_calibration(self) -> Self:
        if self.calibrated is not None and self.due is not None and self.due <= self.calibrated:
            raise ValueError(
                f"the next calibration is due on {self.due}, not after the calibration of {self.calibrated}"
            )
        return self


class Laboratory(StrictModel):
    """Issuer of digital certificates. `code` is that of the accreditation, `country` the code of ISO
    3166-1, and `performed_at` says where the machine stands."""

    name: Words | None = None
    code: Words | None = None
    street: Words | None = None
    post_code: Words | None = None
    city: Words | None = None
    country: Annotated[str, Field(pattern="^[A-Z]{2}$")] | None = None
    e_mail: Words | None = None
    performed_at: Literal["laboratory", "customer", "laboratoryBranch", "customerBranch", "other"] = "other"


class SignatureSettings(StrictModel):
    """Key and certificate with which digital certificates are signed, both in PEM form. The key is the credential
    ``certificate-key`` of systemd or the content of `key_file`."""

    key_file: Path | None = None
    certificate_file: Path | None = None

    def resolved(self, base: Path) -> Self:
        """Return these settings with relative paths resolved against the directory `base`."""
        paths = {name: getattr(self, name) for name in ("key_file", "certificate_file")}
        return self.model_copy(update={name: (base / path).resolve() for name, path in paths.items() if path})


class ReportSettings(StrictModel):
    """Report of a run.

    `language` is that of the report that is stored at the end of each run, and of `volcal report` and the page of a
    plant unless they are asked for another one. The number of the report is `number_prefix` followed by the identity of
    the run. `customer`, `place`, `operator`, `machine` and `instruments` are shown at the head of the report, and
    `procedures` beside the standards. `measured_by` and `approved_by` are the names below the lines for signatures.
    What is not stated is shown as "not stated".

    `laboratory` and `signature` are those of digital certificates (`volcal report --dcc`).

    `tolerances` maps geometric errors of ISO 230-1 (such as EXX or A0Z), the volumetric error VE and the volumetric
    compensated error VCE to their tolerances in µm or µrad. That of a geometric error is compared with its range over
    the travel, and that of a squareness with its absolute value.
    """

    language: Literal["en", "de"] = "en"
    number_prefix: Words | None = None
    customer: Words | None = None
    place: Words | None = None
    operator: Words | None = None
    measured_by: Words | None = None
    approved_by: Words | None = None
    procedures: list[Words] = Field(default=[], max_length=10)
    machine: MachineIdentity = MachineIdentity()
    instruments: list[Instrument] = Field(default=[], max_length=30)
    tolerances: dict[Tolerated, PositiveFloat] = Field(default={})
    laboratory: Laboratory = Laboratory()
    signature: SignatureSettings = SignatureSettings()

    def resolved(self, base: Path) -> Self:
        """Return these settings with relative paths resolved against the directory `base`."""
        return self.model_copy(update={"signature": self.signature.resolved(base)})
