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
