"""Tests of exported `linuxcnc-comp` files in a running stock LinuxCNC: the motors follow them and the error falls."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from compensation_rig import compile_components, machine, running, unavailable_reason
from requirements import skip_if_missing

from twin.compensation.controllers import linuxcnc_comp
from twin.compensation.controllers.export_format import ExportSource
from twin.compensation.controllers.format_options import ExportOptions
from twin.compensation.table import build_table, regular_nodes
from twin.machine.anchor import Anchor
from twin.machine.error_model import ErrorModel
from twin.machine.forward_model import exact_deviation
from twin.machine.kinematic_chain import parse_chain
from twin.machine.machine_population import family_from_amplitudes
from twin.machine.volumetric import evaluation_grid, volumetric_error

pytestmark = skip_if_missing(unavailable_reason())

RANGES = ((0.0, 800.0), (0.0, 400.0), (0.0, 320.0))
TOOL = np.array([0.0, 0.0, -150.0])
AMPLITUDES: dict[str, float | list[float]] = {
    "positioning_um": [9.0, 6.0, 4.0, 2.0, 1.0],
    "straightness_um": [2.0, 1.0, 0.8, 0.6],
    "rotation_urad": [4.0, 2.0, 1.0, 0.8, 0.6],
    "squareness_urad": 4.0,
    "cross_displacement_um": 1.0,
    "cross_rotation_urad": 1.0,
}


def test_a_running_linuxcnc_compensates_the_machines_errors(tmp_path: Path) -> None:
    """The true error has order 7 plus a wave that no series represents; the table contains its orders up to 4."""
    chain = parse_chain("tool-Z-Y-X-bed-workpiece")
    true = ErrorModel.uniform(chain, RANGES, 7, ())
    real = family_from_amplitudes(true, AMPLITUDES).draw(np.random.default_rng(11), 1)[0]
    model = ErrorModel.uniform(chain, RANGES, 4, ())
    parameters = np.array([real[true.index(name)] for name in model.names])
    nodes = regular_nodes(RANGES, (40.0, 40.0, 40.0))
    table = build_table(model, parameters, nodes, TOOL, Anchor(np.zeros(3)), evaluation_grid(RANGES, (2, 2, 2)))
    exported = linuxcnc_comp.export(ExportSource(table), ExportOptions())

    def deviation(points: np.ndarray) -> np.ndarray:
        wave = 5e-4 * np.sin(points[:, [1, 2, 0]] / 45.0)
        return exact_deviation(true, points, TOOL, real) + wave

    grid = evaluation_grid(((7.0, 793.0), (7.0, 393.0), (7.0, 313.0)), (4, 2, 2))
    added = added_by_linuxcnc(tmp_path, exported.files, grid)
    assert added == pytest.approx(exported.correction(grid), abs=1e-6)
    uncorrected = volumetric_error(grid + TOOL, deviation(grid)).aligned_um
    remaining = volumetric_error(grid + TOOL, added + deviation(grid + added)).aligned_um
    wrong_sign = volumetric_error(grid + TOOL, deviation(grid - added) - added).aligned_um
    assert remaining < 0.6 * uncorrected < uncorrected < wrong_sign


def added_by_linuxcnc(folder: Path, files: Mapping[str, str], points: np.ndarray) -> np.ndarray:
    """Return the difference of motors and joints at rest at axis positions (n, 3), shape (n, 3), mm."""
    (folder / "build").mkdir()
    work = machine(folder / "work", compile_components(folder / "build"), "comp-files")
    acting = (work / "tables" / "acting").resolve()
    for letter in "xyz":
        (acting / f"{letter}.comp").write_text(files[f"{letter}.comp"])
    added = []
    with running(work) as controller:
        controller.ready()
        for point in points.tolist():
            controller.at(*point)
            added.append(controller.motor() - np.array([controller.get(f"joint.{n}.pos-cmd") for n in range(3)]))
    return np.array(added)
