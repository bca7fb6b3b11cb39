"""Compensation table as a CSV file with a JSON side file.

The CSV file has the columns `x_mm,y_mm,z_mm,dx_um,dy_um,dz_um` and one row for each node of the grid. In the sequence
of rows, z varies fastest and x slowest. The corrections in the last three columns are ADDED to the commanded position.
The side file contains the grid, the tool offset, the anchor, the nodes outside the measured region, the names of
machine and artefact, and the CRC-32 checksum (IEEE 802.3, as in zlib) of the bytes of the CSV file.
"""

from __future__ import annotations

import json
import math
import zlib
from typing import Literal

import numpy as np
from pydantic import Field

from twin.arrays import Array
from twin.compensation.table import CompensationTable
from twin.errors import DataError, FormatError, ModelError
from twin.formats.csv_reading import CsvRow, read_rows
from twin.formats.json_reading import read_json
from twin.formats.toml_reading import StrictModel
from twin.machine.anchor import Anchor
from twin.machine.kinematic_chain import AXES

COLUMNS = ("x_mm", "y_mm", "z_mm", "dx_um", "dy_um", "dz_um")
FORMAT = "volcal compensation table 1"
_REMEDY = "Write the table again with the version of volcal that reads it"
MEANING = "added to the commanded axis position"

Triple = tuple[float, float, float]
Letter = Literal["X", "Y", "Z"]


class AnchorSection(StrictModel):
    point_mm: Triple
    primary: Letter
    secondary: Letter


class GridSection(StrictModel):
    x_mm: tuple[float, ...] = Field(min_length=2)
    y_mm: tuple[float, ...] = Field(min_length=2)
    z_mm: tuple[float, ...] = Field(min_length=2)


class SideFile(StrictModel):
    """JSON side file of a compensation table.

    `extrapolated_nodes` contains the indices of the nodes outside the region in which the machine was measured. Nodes
    are counted from 0 in the order of the rows of the table's CSV file. `gates_not_passed` contains the names of the
    gates that the table did not pass; the key is absent if all were passed. `machine` and `artefact` are the names of
    the machine that the table corrects and of the artefact with which it was measured; a key is absent if the name is
    not known.
    """

    format: Literal["volcal compensation table 1"]
    meaning: Literal["added to the commanded axis position"]
    crc32: str = Field(pattern="^[0-9a-f]{8}$")
    grid: GridSection
    tool_offset_mm: Triple
    anchor: AnchorSection
    extrapolated_nodes: tuple[int, ...]
    gates_not_passed: tuple[str, ...] = ()
    machine: str = ""
    artefact: str = ""


def format_table(table: CompensationTable) -> str:
    """Return the CSV text of a table, with corrections rounded to 0.1 nm."""
    points = np.stack(np.meshgrid(*table.nodes, indexing="ij"), axis=-1).reshape(-1, 3)
    lines = [",".join(COLUMNS)]
    for point, correction in zip(points.tolist(), (1e3 * table.corrections.reshape(-1, 3)).tolist(), strict=True):
        # 10 digits: 4 m to a nanometre
        position = ",".join(f"{value:.10g}" for value in point)
        # + 0.0 turns a rounded -0.0 into 0.0, so that equal tables give equal bytes and one checksum
        lines.append(position + "," + ",".join(f"{round(value, 4) + 0.0:.4f}" for value in correction))
    return "\n".join(lines) + "\n"


def format_side_file(table: CompensationTable) -> str:
    """Return the JSON text of the side file of a table. The side file contains the checksum of the CSV text that
    `format_table` returns for the same table."""
    x, y, z = (_rounded(nodes) for nodes in table.nodes)
    document: dict[str, object] = {
        "format": FORMAT,
        "meaning": MEANING,
        **{key: name for key, name in (("machine", table.machine), ("artefact", table.artefact)) if name},
        "crc32": checksum(format_table(table)),
        "grid": {"x_mm": x, "y_mm": y, "z_mm": z},
        "tool_offset_mm": table.tool_offset.tolist(),
        "anchor": {
            "point_mm": table.anchor.point_mm.tolist(),
            "primary": table.anchor.primary,
            "secondary": table.anchor.secondary,
        },
        "extrapolated_nodes": np.flatnonzero(table.extrapolated.reshape(-1)).tolist(),
    }
    if table.gates_not_passed:
        document["gates_not_passed"] = list(table.gates_not_passed)
    return json.dumps(document, indent=2) + "\n"


def checksum(text: str) -> str:
    """Return the CRC-32 of the UTF-8 bytes of `text` as eight hexadecimal digits."""
    return f"{zlib.crc32(text.encode()):08x}"


def parse_table(text: str, side_text: str, source: str, side_source: str) -> CompensationTable:
    """Parse a table from the texts of its CSV file and its side file.

    The CRC-32 checksum of the CSV text is compared with the checksum in the side file before the CSV rows are read.
    Raises FormatError, which names the file and the row, column or key, if the checksum differs or a text is invalid.
    """
    side = read_json(side_text, side_source, SideFile, format_name=FORMAT, remedy=_REMEDY)
    found = checksum(text)
    if found != side.crc32:
        raise FormatError(
            f"the table has the CRC-32 {found}, but its side file gives {side.crc32}",
            hint=f"The table was changed after it was written, or {side_source} belongs to another table",
            file=source,
            key="crc32",
        )
    nodes = (np.array(side.grid.x_mm), np.array(side.grid.y_mm), np.array(side.grid.z_mm))
    corrections = _corrections(text, source, nodes)
    shape = corrections.shape[:3]
    try:
        return CompensationTable(
            *nodes,
            corrections=corrections,
            tool_offset=np.array(side.tool_offset_mm),
            anchor=Anchor(np.array(side.anchor.point_mm), side.anchor.primary, side.anchor.secondary),
            extrapolated=_mask(side.extrapolated_nodes, shape, side_source),
            gates_not_passed=side.gates_not_passed,
            machine=side.machine,
            artefact=side.artefact,
        )
    except (DataError, ModelError) as error:
        raise FormatError(error.message, hint=error.hint, file=side_source, **error.where) from None


def _corrections(text: str, source: str, nodes: tuple[Array, Array, Array]) -> Array:
    """Return the corrections (nx, ny, nz, 3) in mm. Raises FormatError if a line does not have the coordinates of its
    node."""
    shape = (len(nodes[0]), len(nodes[1]), len(nodes[2]))
    values = np.empty((math.prod(shape), 3))
    count = 0
    for row in read_rows(text, source, COLUMNS):
        if count == len(values):
            raise row.error(f"more lines than the {len(values)} nodes of the grid", "x_mm")
        _check_node(row, nodes, np.unravel_index(count, shape))
        values[count] = [1e-3 * row.parse_float(name) for name in COLUMNS[3:]]
        count += 1
    if count < len(values):
        raise FormatError(f"{count} lines, but the grid has {len(values)} nodes", file=source)
    return values.reshape(*shape, 3)


def _check_node(row: CsvRow, nodes: tuple[Array, Array, Array], node: tuple[np.intp, ...]) -> None:
    for axis, column in enumerate(COLUMNS[:3]):
        expected, found = float(nodes[axis][node[axis]]), row.parse_float(column)
        # A node elsewhere would apply its correction in a wrong place, whatever the checksum says.
        if abs(found - expected) > 1e-6:
            message = f"{AXES[axis]} is {found:g}, but the grid has {expected:g}"
            raise row.error(message, column, hint="Lines must cover the full grid, x slowest, z fastest")


def _mask(
    indices: tuple[int, ...], shape: tuple[int, ...], source: str
) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    mask = np.zeros(math.prod(shape), dtype=bool)
    for index in indices:
        if not 0 <= index < mask.size:
            raise FormatError(f"node {index} is not in the grid", file=source, key="extrapolated_nodes")
        mask[index] = True
    return mask.reshape(shape)


def _rounded(nodes: Array) -> list[float]:
    """Return the node coordinates rounded as written in the CSV file."""
    return [float(f"{value:.10g}") for value in nodes.tolist()]
