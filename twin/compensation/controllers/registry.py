"""Formats by name."""

from __future__ import annotations

from collections.abc import Mapping

from twin.compensation.controllers import (
    fanuc_3d,
    fanuc_pitch,
    gcode_csv,
    heidenhain_com,
    isg_volcomp,
    linuxcnc_comp,
    neutral,
    siemens_cec,
    siemens_lec,
)
from twin.compensation.controllers.export_format import FormatWriter

WRITERS: Mapping[str, FormatWriter] = {
    "linuxcnc-comp": linuxcnc_comp.export,
    "siemens-lec": siemens_lec.export,
    "siemens-cec": siemens_cec.export,
    "isg-volcomp": isg_volcomp.export,
    "fanuc-pitch": fanuc_pitch.export,
    "fanuc-3d": fanuc_3d.export,
    "heidenhain-com": heidenhain_com.export,
    "gcode-csv": gcode_csv.export,
    "neutral": neutral.export,
}
