"""All options of all export formats, and which format reads which of them. They stand apart from the formats, so that
a command line can offer them without the mathematics that reads them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from twin.compensation.controllers.format_options import (
    AXIS_NAMES,
    REFERENCE_MM,
    FormatOption,
    OneOf,
    PositiveNumber,
    Switch,
    WholeNumber,
)

LARGEST_MAGNIFICATION = 100

ENCODER = FormatOption("encoder", WholeNumber(0, 1), 0, "Siemens LEC: measuring system, 0 or 1.")
FIRST_TABLE = FormatOption("first_table", WholeNumber(0), 0, "Siemens CEC: index of the first table.")
MOST_TABLES = FormatOption("tables", WholeNumber(1), 62, "Siemens CEC: maximum number of tables [default: 62].")
NO_PRODUCTS = FormatOption("no_products", Switch(), False, "Siemens CEC: no multiplied tables.")
DETECTION_UNIT_UM = FormatOption(
    "detection_unit_um", PositiveNumber(), 1.0, "FANUC: detection unit in µm [default: 1]."
)
MAGNIFICATION = FormatOption[int | None](
    "magnification",
    WholeNumber(1, LARGEST_MAGNIFICATION),
    None,
    "FANUC: magnification [default: the smallest that fits].",
)
CONTROL = FormatOption(
    "control",
    OneOf(("30i", "16i")),
    "30i",
    "FANUC: form of the data files [default: 30i; 16i for 0i-P, 16i, 18i, 21i].",
)
"""Family of controllers. From the 30i on, a block of a data file states what it is: Q1 for a parameter, Q0 for pitch
error data.
"""
ACTIVE_BANK = FormatOption("cma_bank", OneOf(("A", "B")), "A", "HEIDENHAIN: active line [default: A].")

OPTIONS_OF_FORMATS: Mapping[str, tuple[FormatOption[Any], ...]] = {
    "linuxcnc-comp": (REFERENCE_MM,),
    "linuxcnc-matrixkins": (),
    "siemens-lec": (REFERENCE_MM, AXIS_NAMES, ENCODER),
    "siemens-cec": (REFERENCE_MM, AXIS_NAMES, FIRST_TABLE, MOST_TABLES, NO_PRODUCTS),
    "isg-volcomp": (),
    "fanuc-pitch": (REFERENCE_MM, CONTROL, DETECTION_UNIT_UM, MAGNIFICATION),
    "fanuc-3d": (REFERENCE_MM, DETECTION_UNIT_UM, MAGNIFICATION),
    "heidenhain-com": (REFERENCE_MM, AXIS_NAMES, ACTIVE_BANK),
    "klipper-skew": (),
    "gcode-csv": (),
    "neutral": (),
}
"""Options that each export format reads, by the name of the format."""


def all_options() -> tuple[FormatOption[object], ...]:
    """Return all options of the export formats, in the order of the formats. An option that several formats read is
    returned once.
    """
    return tuple({option.key: option for options in OPTIONS_OF_FORMATS.values() for option in options}.values())


def formats_with(key: str) -> tuple[str, ...]:
    """Return the names of the export formats that read the option with the key `key`."""
    return tuple(name for name, options in OPTIONS_OF_FORMATS.items() if any(option.key == key for option in options))
