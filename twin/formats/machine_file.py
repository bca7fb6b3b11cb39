"""Machine file (TOML): conversion of its text to a `MachineDescription`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field

from twin.errors import FormatError, TwinError
from twin.formats.beam_section import StructuralBeamSection, derived_from, require_distinct_beams
from twin.formats.deflection_file import parse_deflection
from twin.formats.mounting_section import FootSection, GuideSection, mounting_of
from twin.formats.toml_reading import StrictModel, read_toml
from twin.machine.cross_term import COLUMN_AND_RAM
from twin.machine.deflection import DeflectionGrid
from twin.machine.error_model import CROSS_TERMS, DEFAULT_CROSS_EFFECT, ERROR_MOTIONS, ErrorModel, Ranges
from twin.machine.kinematic_chain import AXES, parse_chain
from twin.machine.machine_description import MachineDescription, Triple
from twin.machine.machine_population import DEFAULT_DECAY, Family, family_from_amplitudes
from twin.machine.structure import DerivedTerm
from twin.units import MICRO_UNITS

DEFAULT_ORDER = 5

Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]
Order = Annotated[int, Field(ge=1, le=15)]
HalfWidths = Annotated[tuple[NotNegative, ...], Field(min_length=1)] | NotNegative
CrossTerm = Literal["b0", "b1", "b2", "c0", "c1"]


class AxisSection(StrictModel):
    """Section of a machine file for one linear axis. `range_mm` is the range in which the error model is valid.
    `travel_mm` contains the soft limits. If `travel_mm` is not given, the soft limits are equal to `range_mm`. `guide`
    describes the guide of the axis."""

    range_mm: tuple[float, float]
    travel_mm: tuple[float, float] | None = None
    rapid_mm_per_min: Positive
    feed_mm_per_min: Positive = 3000.0
    acceleration_mm_per_s2: Positive
    guide: GuideSection | None = None


class AxesSection(StrictModel):
    X: AxisSection
    Y: AxisSection
    Z: AxisSection


class ToolSection(StrictModel):
    offset_mm: tuple[float, float, float]


class FamilySection(StrictModel):
    """Section of a machine file with the half-widths of the uniform distributions of the parameters in the family of
    machines (the prior population), by kind of error.

    A list gives one half-width for each Legendre order, starting with the lowest order of that kind of error. The
    defaults are the amplitudes of the simulated case study in the documentation.
    """

    positioning_um: HalfWidths = (8.0, 5.0, 3.0, 1.8, 1.1)
    straightness_um: HalfWidths = (5.5, 3.3, 2.0, 1.2)
    rotation_urad: HalfWidths = (4.6, 2.8, 1.7, 1.0, 0.6)
    squareness_urad: NotNegative = 9.0
    cross_displacement_um: NotNegative = 4.5
    cross_rotation_urad: NotNegative = 3.0
    decay: Annotated[float, Field(ge=0.0, le=1.0)] = DEFAULT_DECAY


class ModelSection(StrictModel):
    """Section of a machine file that defines the error model.

    `order` is one Legendre order for all error motions, or a table with the order of each error motion. An error motion
    that the table does not list has the order 5.
    """

    order: Order | dict[str, Order] = DEFAULT_ORDER
    cross_effect: bool | tuple[CrossTerm, ...] = True
    family: FamilySection = FamilySection()


class DeflectionSection(StrictModel):
    """Section of a machine file for the gravity deflection of the machine. `grid` is the path of a CSV file with the
    displacements of the tool point, relative to the machine file."""

    grid: Annotated[str, Field(min_length=1)]


class MachineSection(StrictModel):
    """Contents of a machine file."""

    name: Annotated[str, Field(min_length=1)]
    chain: str
    axes: AxesSection
    tools: Annotated[dict[str, ToolSection], Field(min_length=1)]
    model: ModelSection = ModelSection()
    beams: Annotated[tuple[StructuralBeamSection, ...], AfterValidator(require_distinct_beams)] = ()
    feet: tuple[FootSection, ...] = ()
    deflection: DeflectionSection | None = None


def parse_machine(text: str, source: str, read_text: Callable[[str], str]) -> MachineDescription:
    """Return the machine described by TOML text. `source` is the file name used in error messages.

    The function `read_text` takes a path relative to the machine file and returns the text of the file at this path. It
    is used to read the file with the gravity deflection of the machine, if there is one. Raise FormatError, which names
    the file and the key and gives a hint, if a text is invalid.
    """
    section = read_toml(text, source, MachineSection)
    axes = (section.axes.X, section.axes.Y, section.axes.Z)
    for letter, axis in zip(AXES, axes, strict=True):
        _check_interval(axis.range_mm, f"axes.{letter}.range_mm", source)
        _check_interval(axis.travel_mm or axis.range_mm, f"axes.{letter}.travel_mm", source)
    try:
        return _build_description(section, source, axes, read_text)
    except FormatError:
        raise
    except TwinError as error:
        error.at(key="chain" if "chain" in error.where else "model")
        raise FormatError(error.message, hint=error.hint, file=source, **error.where) from None


def _build_description(
    section: MachineSection, source: str, axes: Sequence[AxisSection], read_text: Callable[[str], str]
) -> MachineDescription:
    ranges = _triple_of_pairs([axis.range_mm for axis in axes])
    model = ErrorModel(parse_chain(section.chain), ranges, _orders(section.model, source), _cross_effect(section.model))
    derived = _derived(section, model, source)
    model = replace(model, **_cross_terms(derived)) if section.beams else model
    amplitudes = section.model.family.model_dump() | _expected_sizes(derived)
    family = family_from_amplitudes(model, amplitudes)
    _require_widths(family, derived, source)
    return MachineDescription(
        name=section.name,
        model=model,
        limits=_triple_of_pairs([axis.travel_mm or axis.range_mm for axis in axes]),
        rapid_mm_per_min=_triple([axis.rapid_mm_per_min for axis in axes]),
        feed_mm_per_min=_triple([axis.feed_mm_per_min for axis in axes]),
        acceleration_mm_per_s2=_triple([axis.acceleration_mm_per_s2 for axis in axes]),
        tools={name: np.array(tool.offset_mm) for name, tool in section.tools.items()},
        family=family,
        amplitudes=amplitudes,
        deflection=_deflection(section.deflection, source, read_text),
        derived_terms=derived,
        beams=tuple(beam.beam for beam in section.beams),
        mounting=mounting_of(dict(zip(AXES, (axis.guide for axis in axes), strict=True)), section.feet),
    )


def _derived(section: MachineSection, model: ErrorModel, source: str) -> tuple[DerivedTerm, ...]:
    if section.beams and "cross_effect" in section.model.model_fields_set:
        message = "the beams of this file determine the cross-effect, so it cannot be stated as well"
        raise FormatError(message, hint="Remove cross_effect or the beams", file=source, key="model.cross_effect")
    return derived_from(section.beams, model, source)


def _require_widths(family: Family, derived: Sequence[DerivedTerm], source: str) -> None:
    """Raise FormatError if a parameter of the beams would be held at zero by a half-width of zero."""
    for one in derived:
        if not one.redundant and family.half_widths[family.model.index(one.term.name)] == 0.0:
            key = "model.family.cross_displacement_um" if one.term.unit == "mm" else "model.family.cross_rotation_urad"
            message = f"the half-width of {one.term.name} is 0, so this effect of the beams would not be identified"
            hint = "Set this key to more than 0, or state all masses and stiffnesses of the beams"
            raise FormatError(message, hint=hint, file=source, key=key, beam=one.beams[0])


def _cross_terms(derived: Sequence[DerivedTerm]) -> dict[str, Any]:
    """Return the fields `cross_effect` and `structure` of the error model."""
    active = [one.term for one in derived if not one.redundant]
    of_column = {term: short for short, term in COLUMN_AND_RAM.items()}
    found = {of_column[term] for term in active if term in of_column}
    return {
        "cross_effect": tuple(short for short in CROSS_TERMS if short in found),
        "structure": tuple(term for term in active if term not in of_column),
    }


def _expected_sizes(derived: Sequence[DerivedTerm]) -> dict[str, float]:
    """Return the half-widths in µm or µrad of the terms whose size follows from masses and stiffnesses."""
    return {
        one.term.name: MICRO_UNITS[one.term.unit][1] * abs(one.expected)
        for one in derived
        if one.expected is not None and not one.redundant
    }


def _orders(model: ModelSection, source: str) -> dict[str, int]:
    if isinstance(model.order, int):
        return dict.fromkeys(ERROR_MOTIONS, model.order)
    for error in model.order:
        if error not in ERROR_MOTIONS:
            hint = f"The 18 error motions are {', '.join(ERROR_MOTIONS)}"
            raise FormatError(f"'{error}' is not an error motion", hint=hint, file=source, key=f"model.order.{error}")
    return {error: model.order.get(error, DEFAULT_ORDER) for error in ERROR_MOTIONS}


def _cross_effect(model: ModelSection) -> tuple[str, ...]:
    if isinstance(model.cross_effect, bool):
        return DEFAULT_CROSS_EFFECT if model.cross_effect else ()
    return tuple(term for term in CROSS_TERMS if term in model.cross_effect)


def _deflection(
    section: DeflectionSection | None, source: str, read_text: Callable[[str], str]
) -> DeflectionGrid | None:
    if section is None:
        return None
    try:
        text = read_text(section.grid)
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        hint = "The path is relative to the machine file"
        message = f"the deflection grid '{section.grid}' cannot be read: {reason}"
        raise FormatError(message, hint=hint, file=source, key="deflection.grid") from None
    return parse_deflection(text, section.grid)


def _check_interval(interval: tuple[float, float], key: str, source: str) -> None:
    if not interval[0] < interval[1]:
        message = f"range [{interval[0]:g}, {interval[1]:g}] is empty or reversed"
        raise FormatError(message, hint="Write the lower limit first, in mm", file=source, key=key)


def _triple(values: list[float]) -> Triple:
    return values[0], values[1], values[2]


def _triple_of_pairs(values: list[tuple[float, float]]) -> Ranges:
    return values[0], values[1], values[2]
