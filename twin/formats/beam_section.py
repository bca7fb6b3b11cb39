"""Sections of a machine file that describe the beams of which the machine consists."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from twin.errors import FormatError, ModelError
from twin.formats.toml_reading import StrictModel
from twin.machine.beam_flexibility import Ends
from twin.machine.error_model import ErrorModel
from twin.machine.structure import BeamLoad, Crossbeam, DerivedTerm, StructuralBeam, derive_terms

AxisLetter = Literal["X", "Y", "Z"]
Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]{0,23}$")]
Triple = tuple[float, float, float]
Positive = Annotated[float, Field(gt=0.0)]

_N_PER_MM2_PER_GPA = 1e3


class LoadSection(StrictModel):
    """Section of a machine file for a mass that loads a beam."""

    name: Name
    carried_by: AxisLetter
    centre_mm: Triple
    mass_kg: Positive | None = None


class CrossbeamSection(StrictModel):
    """Section of a machine file for a crossbeam one end of which rests on a beam."""

    axis: AxisLetter
    here_mm: float
    other_mm: float

    @model_validator(mode="after")
    def _has_a_length(self) -> CrossbeamSection:
        if self.here_mm == self.other_mm:
            raise ValueError("the two ends of the crossbeam are at the same position; write here_mm and other_mm")
        return self


class StructuralBeamSection(StrictModel):
    """Section of a machine file for a beam. `second_moment_mm4` and `youngs_modulus_gpa` give its bending stiffness,
    `torsion_constant_mm4` and `shear_modulus_gpa` its torsional stiffness."""

    name: Name
    axis: AxisLetter
    ends: Ends
    supports_mm: Annotated[tuple[float, ...], Field(min_length=1, max_length=2)]
    loads: Annotated[tuple[LoadSection, ...], Field(min_length=1)]
    crossbeam: CrossbeamSection | None = None
    reference_mm: Triple = (0.0, 0.0, 0.0)
    youngs_modulus_gpa: Positive | None = None
    second_moment_mm4: Positive | None = None
    shear_modulus_gpa: Positive | None = None
    torsion_constant_mm4: Positive | None = None

    @model_validator(mode="after")
    def _stiffness_is_complete(self) -> StructuralBeamSection:
        for modulus, moment in (
            ("youngs_modulus_gpa", "second_moment_mm4"),
            ("shear_modulus_gpa", "torsion_constant_mm4"),
        ):
            stated = [name for name in (modulus, moment) if getattr(self, name) is not None]
            if len(stated) == 1:
                raise ValueError(f"{stated[0]} is stated alone; {modulus} and {moment} belong together")
        return self

    @model_validator(mode="after")
    def _names_differ(self) -> StructuralBeamSection:
        _require_distinct([load.name for load in self.loads], "load")
        return self

    @property
    def beam(self) -> StructuralBeam:
        return StructuralBeam(
            name=self.name,
            axis=self.axis,
            ends=self.ends,
            supports_mm=self.supports_mm,
            loads=tuple(BeamLoad(one.name, one.carried_by, one.centre_mm, one.mass_kg) for one in self.loads),
            crossbeam=None if self.crossbeam is None else Crossbeam(**self.crossbeam.model_dump()),
            reference_mm=self.reference_mm,
            bending_n_mm2=_stiffness(self.youngs_modulus_gpa, self.second_moment_mm4),
            torsion_n_mm2=_stiffness(self.shear_modulus_gpa, self.torsion_constant_mm4),
        )


def _require_distinct(names: list[str], kind: str) -> None:
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"two {kind}s are called '{name}'; give each {kind} a name of its own")


def require_distinct_beams(beams: tuple[StructuralBeamSection, ...]) -> tuple[StructuralBeamSection, ...]:
    """Return the beams. Raises ValueError if two of them have the same name."""
    _require_distinct([beam.name for beam in beams], "beam")
    return beams


def derived_from(beams: tuple[StructuralBeamSection, ...], model: ErrorModel, source: str) -> tuple[DerivedTerm, ...]:
    """Return the terms of the cross-effect that follow from the beams of a machine file. Raises FormatError, which
    names the file `source` and the beam, if a beam does not suit the machine."""
    try:
        return derive_terms([section.beam for section in beams], model)
    except ModelError as error:
        place = [section.name for section in beams].index(error.where.get("beam", beams[0].name))
        raise FormatError(error.message, hint=error.hint, file=source, key=f"beams[{place}]", **error.where) from None


def _stiffness(modulus_gpa: float | None, moment_mm4: float | None) -> float | None:
    """Return the stiffness in N mm², or None if it is not stated."""
    if modulus_gpa is None or moment_mm4 is None:
        return None
    return _N_PER_MM2_PER_GPA * modulus_gpa * moment_mm4
