"""Registry of all formats for the export of compensation tables to controllers, by name."""

from __future__ import annotations

from collections.abc import Mapping

from twin.compensation.controllers import (
    fanuc_3d,
    fanuc_pitch,
    gcode_csv,
    heidenhain_com,
    isg_volcomp,
    klipper_skew,
    linuxcnc_comp,
    linuxcnc_matrixkins,
    neutral,
    siemens_cec,
    siemens_lec,
)
from twin.compensation.controllers.export_format import ExportFormat
from twin.compensation.controllers.format_options import FormatOption

FORMATS: Mapping[str, ExportFormat] = {
    one.name: one
    for one in (
        linuxcnc_comp.FORMAT,
        linuxcnc_matrixkins.FORMAT,
        siemens_lec.FORMAT,
        siemens_cec.FORMAT,
        isg_volcomp.FORMAT,
        fanuc_pitch.FORMAT,
        fanuc_3d.FORMAT,
        heidenhain_com.FORMAT,
        klipper_skew.FORMAT,
        gcode_csv.FORMAT,
        neutral.FORMAT,
    )
}


def all_options() -> tuple[FormatOption[object], ...]:
    """Return all options that the export formats declare, in the order of the formats. An option that several formats
    declare is returned once.
    """
    return tuple({option.key: option for one in FORMATS.values() for option in one.options}.values())


def formats_with(key: str) -> tuple[str, ...]:
    """Return the names of the export formats that read the option with the key `key`."""
    return tuple(name for name, one in FORMATS.items() if any(option.key == key for option in one.options))
