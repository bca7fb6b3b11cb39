"""Artefact file (TOML): the calibration certificate of a ball artefact.

Ball centres are listed (`balls = [[x, y, z], …]`, in mm) or, for a bar without a certificate, described by a section
`[bar]`. An artefact without a certificate states the length between its end balls, with a large uncertainty of the
centres.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from twin.arrays import Array
from twin.artefact.artefact import Artefact, bar_balls
from twin.artefact.artefact_body import ArtefactBody, Beam, Rod, Vector, check_part_name, cover_box, vector
from twin.artefact.certificate import (
    MAX_CTE_PER_K,
    REFERENCE_RANGE_C,
    BallDistance,
    end_balls,
    with_length_uncertainty,
    with_reference_length,
    with_uncertified,
)
from twin.errors import DataError, FormatError
from twin.formats.csv_reading import csv_lines
from twin.formats.toml_reading import StrictModel, read_toml
from twin.units import MM_PER_UM, REFERENCE_TEMPERATURE_C, UM_PER_MM

ReadText = Callable[[str], str]
"""Function that takes a file name as written in another file, resolves it relative to that file, and returns the text
of the named file."""

_LARGEST_MM = 1e6  # no length of an artefact; its squares, with all factors, are finite
_Coordinate = Annotated[float, Field(ge=-_LARGEST_MM, le=_LARGEST_MM)]
Coordinates = tuple[_Coordinate, _Coordinate, _Coordinate]


class BarSection(StrictModel):
    """Section `[bar]` of an artefact file: equally spaced balls on a straight bar. The function
    `twin.artefact.artefact.bar_balls` computes the ball centres from its values."""

    balls: Annotated[int, Field(ge=2, le=99)]
    length_mm: Annotated[float, Field(gt=0.0, le=_LARGEST_MM)]
    tilt_deg: Annotated[float, Field(ge=0.0, lt=90.0)] = 0.0
    holder_length_mm: Annotated[float, Field(ge=0.0, le=_LARGEST_MM)] = 0.0


class ReferenceLengthSection(StrictModel):
    """Section `[[reference_lengths]]` of an artefact file: the distance between the centres of two balls at the
    reference temperature, measured independently of the certificate."""

    balls: tuple[int, int]
    length_mm: Annotated[float, Field(gt=0.0)]
    standard_uncertainty_um: Annotated[float, Field(gt=0.0)]


class HoldersSection(StrictModel):
    """Section `[holders]` of an artefact file: rods from a foot to the centre of each ball. The feet are listed
    (`feet_mm`), or all balls are `length_mm` from their feet in the direction `direction`. Without either, the feet are
    on the X axis of the artefact frame."""

    radius_mm: Annotated[float, Field(ge=0.0)] = 4.0
    direction: Coordinates | None = None
    length_mm: Annotated[float, Field(ge=0.0)] | None = None
    feet_mm: list[Coordinates] | None = None

    @model_validator(mode="after")
    def _one_rule(self) -> Self:
        if (self.direction is None) != (self.length_mm is None):
            raise ValueError("give 'direction' and 'length_mm' together")
        if self.direction is not None and self.feet_mm is not None:
            raise ValueError("give either 'feet_mm' or 'direction' with 'length_mm'")
        if self.direction is not None and not any(self.direction):
            raise ValueError("'direction' must not be zero")
        return self

    def feet(self, balls: Array) -> tuple[Vector, ...] | None:
        """Return the stated feet of the holders of `balls` (N, 3) in mm; None if they are not stated."""
        if self.direction is None or self.length_mm is None:
            return None if self.feet_mm is None else tuple(self.feet_mm)
        along = np.array(self.direction) / math.hypot(*self.direction)
        return tuple(vector(foot) for foot in balls - self.length_mm * along)


class BeamSection(StrictModel):
    """Section `[beam]` of an artefact file: the straight beam of a ball bar, on the X axis of the artefact frame."""

    radius_mm: Annotated[float, Field(ge=0.0)] = 15.0
    overhang_mm: Annotated[float, Field(ge=0.0)] = 15.0


class BodySection(StrictModel):
    """Section `[[bodies]]` of an artefact file: a solid part in the artefact frame. It is either a rod with round ends
    (`from_mm`, `to_mm`, `radius_mm`) or a box (`lower_mm`, `upper_mm`) with faces perpendicular to the axes."""

    name: Annotated[str, Field(min_length=1)] = "frame"
    from_mm: Coordinates | None = None
    to_mm: Coordinates | None = None
    radius_mm: Annotated[float, Field(gt=0.0)] | None = None
    lower_mm: Coordinates | None = None
    upper_mm: Coordinates | None = None

    @model_validator(mode="after")
    def _rod_or_box(self) -> Self:
        given = {name for name in BodySection.model_fields if name != "name" and getattr(self, name) is not None}
        if given not in ({"from_mm", "to_mm", "radius_mm"}, {"lower_mm", "upper_mm"}):
            raise ValueError("give either 'from_mm', 'to_mm' and 'radius_mm' (rod) or 'lower_mm' and 'upper_mm' (box)")
        return self

    def rods(self) -> tuple[Rod, ...]:
        """Return the rods that form or enclose the part. Raises DataError if its name or its corners are wrong."""
        check_part_name(self.name)
        if self.lower_mm is not None and self.upper_mm is not None:
            return cover_box(self.name, self.lower_mm, self.upper_mm)
        assert self.from_mm is not None and self.to_mm is not None  # noqa: S101  checked by _rod_or_box
        return (Rod(self.name, self.from_mm, self.to_mm, self.radius_mm or 0.0),)


class ArtefactDocument(StrictModel):
    """Keys of an artefact file. Uncertainties are standard uncertainties (k = 1)."""

    name: Annotated[str, Field(min_length=1)]
    certificate: str = "nominal, not calibrated"
    reference_temperature_c: Annotated[float, Field(ge=REFERENCE_RANGE_C[0], le=REFERENCE_RANGE_C[1])] = (
        REFERENCE_TEMPERATURE_C
    )
    cte_per_k: Annotated[float, Field(ge=-MAX_CTE_PER_K, le=MAX_CTE_PER_K)]
    cte_standard_uncertainty_per_k: Annotated[float, Field(ge=0.0, le=MAX_CTE_PER_K)]
    ball_diameter_mm: Annotated[float, Field(gt=0.0)]
    balls: Annotated[list[Coordinates], Field(min_length=2)] | None = None
    bar: BarSection | None = None
    standard_uncertainty_um: Annotated[float, Field(ge=0.0)] | None = None
    covariance_file: str | None = None
    holder_length_mm: Annotated[float, Field(ge=0.0)] | None = None
    sag_um: Annotated[float, Field(ge=0.0)] | None = None
    sag_standard_uncertainty_um: Annotated[float, Field(ge=0.0)] | None = None
    length_standard_uncertainty_ppm: Annotated[float, Field(ge=0.0, le=1000.0)] = 0.0
    uncertified_balls: tuple[int, ...] = ()
    end_length_mm: Annotated[float, Field(gt=0.0)] | None = None
    end_length_standard_uncertainty_um: Annotated[float, Field(gt=0.0)] | None = None
    reference_lengths: tuple[ReferenceLengthSection, ...] = ()
    holders: HoldersSection = HoldersSection()
    beam: BeamSection | None = None
    bodies: tuple[BodySection, ...] | None = None

    @model_validator(mode="after")
    def _one_of_each(self) -> Self:
        if (self.balls is None) == (self.bar is None):
            raise ValueError("give the balls either as 'balls = [[x, y, z], ...]' or by a [bar] section")
        if (self.standard_uncertainty_um is None) == (self.covariance_file is None):
            raise ValueError("give either 'standard_uncertainty_um' or 'covariance_file'")
        if (self.end_length_mm is None) != (self.end_length_standard_uncertainty_um is None):
            raise ValueError("give both 'end_length_mm' and 'end_length_standard_uncertainty_um', or neither")
        stated_feet = self.holders.feet_mm is not None or self.holders.direction is not None
        if stated_feet and self.beam is None and self.bodies is None:
            raise ValueError(
                "the [holders] have stated feet, so the part that carries them must be stated too: [[bodies]], or "
                "[beam] for a bar along X; 'bodies = []' if there is none"
            )
        if self.bodies is not None and self.beam is None:
            for key, value in (
                ("sag_um", self.sag_um),
                ("sag_standard_uncertainty_um", self.sag_standard_uncertainty_um),
            ):
                if value:
                    raise ValueError(f"'{key}' describes a bar that is held in its middle; remove it or give [beam]")
        return self


def parse_artefact(text: str, source: str, read_text: ReadText | None = None) -> Artefact:
    """Return the artefact described by TOML text.

    Raise FormatError, which names `source` and the key, if the text is invalid. Raise DataError if a value is
    impossible. If the text names a file with the covariance of the ball centres, the function `read_text` is called
    with its path and returns its text.
    """
    if text.lstrip().startswith("<"):
        raise FormatError(
            "this is XML and not an artefact file",
            hint="Import a digital calibration certificate with `volcal artefact import`",
            file=source,
        )
    document = read_toml(text, source, ArtefactDocument)
    balls, holder = _balls(document)
    covariance = _covariance(document, len(balls), source, read_text)
    try:
        lengths = _measured_lengths(document, balls, source)
        balls, covariance = _with_additions(document, balls, covariance, lengths, source)
        artefact = Artefact(
            name=document.name,
            certificate=_certificate(document, [length for _, length in lengths]),
            balls=balls,
            ball_diameter_mm=document.ball_diameter_mm,
            reference_temperature_c=document.reference_temperature_c,
            cte_per_k=document.cte_per_k,
            cte_standard_uncertainty_per_k=document.cte_standard_uncertainty_per_k,
            covariance=covariance,
            holder_length_mm=holder,
            sag_mm=MM_PER_UM * (document.sag_um or 0.0),
            uncertified=tuple(sorted(set(document.uncertified_balls))),
            body=_body(document, balls),
        )
        return replace(artefact, sag_standard_uncertainty_mm=_sag_doubt_mm(document, artefact))
    except DataError as error:
        raise error.at(file=source) from None


def _sag_doubt_mm(document: ArtefactDocument, artefact: Artefact) -> float:
    """Return the standard uncertainty in mm of the sag. A stated sag is exact unless the file says otherwise, and one
    that is not stated may be as large as that of a beam of this shape."""
    if document.sag_standard_uncertainty_um is not None:
        return MM_PER_UM * document.sag_standard_uncertainty_um
    return artefact.expected_sag_mm if document.sag_um is None else 0.0


def _body(document: ArtefactDocument, balls: Array) -> ArtefactBody:
    """Return the solid parts besides the `balls` (N, 3). An artefact that states none is a bar."""
    beam = document.beam or (BeamSection() if document.bodies is None else None)
    try:
        parts = tuple(rod for body in document.bodies or () for rod in body.rods())
    except DataError as error:
        raise error.at(key="bodies") from None
    return ArtefactBody(
        holder_radius_mm=document.holders.radius_mm,
        feet_mm=document.holders.feet(balls),
        beam=None if beam is None else Beam(beam.radius_mm, beam.overhang_mm),
        parts=parts,
    )


def format_artefact(artefact: Artefact, covariance_file: str, notes: Sequence[str] = ()) -> tuple[str, str]:
    """Return the texts of an artefact file and of the file `covariance_file` that it names. `notes` are written as
    comments at the head of the artefact file. All numbers are written in full, so that reading returns the same
    artefact."""
    rows = ",\n".join(f"  [{', '.join(repr(value) for value in ball)}]" for ball in artefact.balls.tolist())
    entries = {
        "name": _quoted(artefact.name),
        "certificate": _quoted(artefact.certificate),
        "reference_temperature_c": repr(float(artefact.reference_temperature_c)),
        "cte_per_k": repr(float(artefact.cte_per_k)),
        "cte_standard_uncertainty_per_k": repr(float(artefact.cte_standard_uncertainty_per_k)),
        "ball_diameter_mm": repr(float(artefact.ball_diameter_mm)),
        "holder_length_mm": repr(float(artefact.holder_length_mm)),
        "sag_um": repr(float(UM_PER_MM * artefact.sag_mm)),
        "sag_standard_uncertainty_um": repr(float(UM_PER_MM * artefact.sag_standard_uncertainty_mm)),
        "uncertified_balls": repr(list(artefact.uncertified)),
        "covariance_file": _quoted(covariance_file),
        "balls": f"[\n{rows},\n]",
    }
    lines = [f"# {_comment(note)}" for note in notes] + [f"{key} = {value}" for key, value in entries.items()]
    lines += _body_lines(artefact.body)
    covariance = (UM_PER_MM**2 * artefact.covariance).tolist()
    table = "".join(",".join(repr(value) for value in row) + "\n" for row in covariance)
    return "\n".join(lines) + "\n", table


def _comment(note: str) -> str:
    """Return the text in one line, without the control characters that TOML forbids: a line feed in the name of an
    artefact must not begin a key."""
    return " ".join("".join(c if c.isprintable() else " " for c in note).split())


def _quoted(text: str) -> str:
    """Return the text as a basic string of TOML, which unlike one of JSON must not contain U+007F."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _body_lines(body: ArtefactBody) -> list[str]:
    """Return the lines of the sections on the solid parts."""
    lines = ["bodies = []"] if body.beam is None and not body.parts else []
    lines += ["[holders]", f"radius_mm = {body.holder_radius_mm!r}"]
    if body.feet_mm is not None:
        lines.append(f"feet_mm = {[list(foot) for foot in body.feet_mm]}")
    if body.beam is not None:
        lines += ["[beam]", f"radius_mm = {body.beam.radius_mm!r}", f"overhang_mm = {body.beam.overhang_mm!r}"]
    for rod in body.parts:
        lines += ["[[bodies]]", f"name = {_quoted(rod.name)}"]
        lines += [f"from_mm = {list(rod.start_mm)}", f"to_mm = {list(rod.end_mm)}", f"radius_mm = {rod.radius_mm!r}"]
    return lines


def _with_additions(
    document: ArtefactDocument,
    balls: Array,
    covariance: Array,
    lengths: Sequence[tuple[str, BallDistance]],
    source: str,
) -> tuple[Array, Array]:
    """Return the centres (N, 3) in mm and their covariance (3N, 3N) in mm² with all that the file states in addition to
    the certificate. Each of `lengths` is given with its key."""
    covariance = with_length_uncertainty(balls, covariance, document.length_standard_uncertainty_ppm)
    try:
        covariance = with_uncertified(covariance, document.uncertified_balls)
    except DataError as error:
        raise error.at(file=source, key="uncertified_balls") from None
    for key, length in lengths:
        try:
            balls, covariance = with_reference_length(balls, covariance, length)
        except DataError as error:
            raise error.at(file=source, key=key) from None
    return balls, covariance


def _measured_lengths(document: ArtefactDocument, balls: Array, source: str) -> list[tuple[str, BallDistance]]:
    """Return the key and the value of each length that the file states in addition to the centres `balls` (N, 3)."""
    lengths = [
        ("reference_lengths", BallDistance(one.balls, one.length_mm, one.standard_uncertainty_um * 1e-3))
        for one in document.reference_lengths
    ]
    if document.end_length_mm is None or document.end_length_standard_uncertainty_um is None:
        return lengths
    uncertainty_mm = document.end_length_standard_uncertainty_um * 1e-3
    try:
        return [("end_length_mm", BallDistance(end_balls(balls), document.end_length_mm, uncertainty_mm)), *lengths]
    except DataError as error:
        raise error.at(file=source, key="end_length_mm") from None


def _certificate(document: ArtefactDocument, lengths: Sequence[BallDistance]) -> str:
    """Return the name of the certificate with the additions of the file, for reports."""
    parts = [document.certificate]
    if document.uncertified_balls:
        numbers = ", ".join(str(ball) for ball in sorted(set(document.uncertified_balls)))
        parts.append(f"uncertified balls: {numbers}")
    parts += [length.text for length in lengths]
    return "; ".join(parts)


def _balls(document: ArtefactDocument) -> tuple[Array, float]:
    if document.bar is not None:
        bar = document.bar
        centres = bar_balls(bar.balls, bar.length_mm, math.radians(bar.tilt_deg), bar.holder_length_mm)
        return centres, bar.holder_length_mm
    centres = np.array(document.balls, dtype=np.float64)
    stated = document.holder_length_mm
    return centres, float(np.hypot(centres[:, 1], centres[:, 2]).max()) if stated is None else stated


def _covariance(document: ArtefactDocument, count: int, source: str, read_text: ReadText | None) -> Array:
    if document.standard_uncertainty_um is not None:
        return np.eye(3 * count) * (document.standard_uncertainty_um * 1e-3) ** 2
    name = document.covariance_file or ""
    if read_text is None:
        raise FormatError("a covariance file is not supported here", file=source, key="covariance_file")
    return _parse_covariance(read_text(name), name, 3 * count) * 1e-6


def _parse_covariance(text: str, source: str, size: int) -> Array:
    """Return the covariance matrix (size, size) in µm² from CSV text without a header.

    The text has one row for each coordinate, ball by ball in the order x, y, z.
    """
    rows = [row for _, row in csv_lines(text, source) if row]
    if len(rows) != size:
        raise FormatError(f"{len(rows)} rows, expected {size} (3 per ball)", file=source)
    values = np.empty((size, size))
    for number, row in enumerate(rows):
        if len(row) != size:
            raise FormatError(f"{len(row)} columns, expected {size}", file=source, row=number + 1)
        for column, cell in enumerate(row):
            values[number, column] = _number(cell, source, number + 1, column + 1)
    return values


def _number(cell: str, source: str, row: int, column: int) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise FormatError(f"'{cell}' is not a finite number", file=source, row=row, column=column)
    return value
