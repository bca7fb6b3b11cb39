"""Input files of the command `volcal gcode correct`. They are the neutral CSV table and the JSON file that belongs to
it.
"""

from __future__ import annotations

from dataclasses import replace

from twin.compensation.controllers.export_format import ControllerExport, ExportFormat, ExportSource
from twin.compensation.controllers.format_options import ExportOptions
from twin.compensation.table_file import format_side_file, format_table


def export(source: ExportSource, choices: ExportOptions) -> ControllerExport:
    """Return the export of a compensation table as the texts of the two files `table.csv` and `table.json` that `volcal
    gcode correct` reads.
    """
    written = replace(source.table, corrections=choices.sign * source.table.corrections)
    files = {"table.csv": format_table(written), "table.json": format_side_file(written)}
    return ControllerExport(
        files, source.table.at, ("nothing: a controller without tables is corrected as the table says",)
    )


FORMAT = ExportFormat("gcode-csv", export)
