"""Files of every controller format compared with files written by hand.

A table of 3 × 3 × 3 nodes 100 mm apart. With node numbers x = 0, 1, 2 and z = 0, 1, 2, in µm: dx = x, but 4 x at z = 2;
dy = 4 z; dz = 0. Averaged over the other axes X needs 0, 2, 4 along X and 0, 0, 3 along Z; the remainder is a product,
(-2, 0, 2) along X times (-½, -½, 1) along Z, at the reference point 1 - 1 = 0 with (-1, -1, 2) along Z. SINUMERIK gets
half of the product twice: a = √0.001 (-1, 0, 1), b = √0.001 (-½, -½, 1) in mm, and -a times -b. For error
motions: a machine with EXX = -2, 0, 2 µm along X and a cross-effect EYZ = 6 µm at the far end of Y and Z.
"""

from __future__ import annotations

import json
import zlib
from pathlib import Path

import numpy as np
import pytest

from twin.compensation.controllers.export_format import ExportSource, TableEstimate
from twin.compensation.controllers.format_options import ExportOptions
from twin.compensation.controllers.registry import FORMATS
from twin.compensation.table import CompensationTable, build_table
from twin.machine.anchor import Anchor
from twin.machine.error_model import ErrorModel
from twin.machine.kinematic_chain import parse_chain

HERE = Path(__file__).parent / "controllers"


def by_hand() -> ExportSource:
    nodes = np.array([0.0, 100.0, 200.0])
    corrections = np.zeros((3, 3, 3, 3))
    for x in range(3):
        for z in range(3):
            corrections[x, :, z, 0] = x * (4e-3 if z == 2 else 1e-3)
            corrections[x, :, z, 1] = 4e-3 * z
    marks = np.zeros((3, 3, 3), dtype=bool)
    marks[2, 2, 2] = True
    return ExportSource(CompensationTable(nodes, nodes, nodes, corrections, np.zeros(3), Anchor(np.zeros(3)), marks))


def of_error_motions() -> ExportSource:
    ranges = ((0.0, 200.0), (0.0, 200.0), (0.0, 200.0))
    model = ErrorModel.uniform(parse_chain("tool-Y-Z-X-bed-workpiece"), ranges, 1, ("b1",))
    parameters = np.zeros(model.size)
    parameters[model.index("EXX[1]")] = 2e-3
    parameters[model.index("CROSS[b1]")] = 6e-3
    ends = np.array([0.0, 200.0])
    nodes = (np.array([0.0, 100.0, 200.0]), ends, ends)
    corners = np.array(np.meshgrid(*nodes)).reshape(3, -1).T
    table = build_table(model, parameters, nodes, np.array([0.0, 250.0, 0.0]), Anchor(np.zeros(3)), corners)
    return ExportSource(table, TableEstimate(model, parameters, np.zeros((model.size, model.size))))


@pytest.mark.parametrize("name", sorted(FORMATS))
def test_the_files_are_those_written_by_hand(name: str) -> None:
    source = of_error_motions() if name == "isg-volcomp" else by_hand()
    found = dict(FORMATS[name].export(source, ExportOptions()).files)
    found.pop("table.json", None)
    assert found == {path.name: path.read_text(encoding="utf-8") for path in (HERE / name).iterdir()}


def test_the_side_file_of_a_table_for_part_programs() -> None:
    files = FORMATS["gcode-csv"].export(by_hand(), ExportOptions()).files
    side = json.loads(files["table.json"])
    assert side["grid"] == {key: [0.0, 100.0, 200.0] for key in ("x_mm", "y_mm", "z_mm")}
    assert side["crc32"] == f"{zlib.crc32(files['table.csv'].encode()):08x}"
    assert side["extrapolated_nodes"] == [26]


def test_the_example_of_a_parameter_manual() -> None:
    """Check B-63980EN, page 100: reference number 40, interval 50 mm, and the values of numbers 33 to 49.

    The amounts are added up by hand from the reference point in both directions.
    """
    values = [2, 1, 1, -2, 0, -1, 0, -1, 2, 1, 0, -1, -1, -2, 0, 1, 2]
    amounts = [0, 2, 3, 4, 2, 2, 1, 1, 0, 2, 3, 3, 2, 1, -1, -1, 0, 2]
    x = np.linspace(-400.0, 450.0, 18)
    ends = np.array([0.0, 100.0])
    corrections = np.zeros((18, 2, 2, 3))
    corrections[..., 0] = 1e-3 * np.array(amounts)[:, None, None]
    marks = np.zeros((18, 2, 2), dtype=bool)
    table = CompensationTable(x, ends, ends, corrections, np.zeros(3), Anchor(np.zeros(3)), marks)
    files = FORMATS["fanuc-pitch"].export(ExportSource(table), ExportOptions()).files
    reference, first = (int(files["parameters.txt"].splitlines()[row].split("A1P")[1].split("A")[0]) for row in (1, 2))
    assert reference - first == 40 - 33
    data = dict(line[1:].split("Q0P") for line in files["pitch-error.txt"].splitlines()[1:-1])
    found = [int(data[str(10000 + first + place)]) for place in range(len(values))]
    assert found == values


def test_data_files_of_fanuc_controls_before_the_30i_have_no_identifier() -> None:
    files = FORMATS["fanuc-pitch"].export(by_hand(), ExportOptions({"control": "16i"})).files
    for name, text in files.items():
        later = (HERE / "fanuc-pitch" / name).read_text(encoding="utf-8")
        assert text == later.replace("Q0", "").replace("Q1", "")
