"""For every table, grid and reference point the controller adds the exported correction, and no more is lost than
stated.
"""

from __future__ import annotations

import numpy as np
import pytest
from controller_rules import RULES, rule_at
from estimated_machine import source_of
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.compensation.controllers.export_format import ControllerExport, ExportSource
from twin.compensation.controllers.format_options import ExportOptions
from twin.compensation.controllers.registry import FORMATS
from twin.compensation.table import CompensationTable
from twin.machine.anchor import Anchor
from twin.machine.error_model import ErrorModel
from twin.machine.kinematic_chain import parse_chain

CHAINS = (
    "tool-Y-Z-X-bed-workpiece",
    "tool-Z-Y-X-bed-workpiece",
    "tool-Z-bed-Y-X-workpiece",
    "tool-Y-bed-X-Z-workpiece",
)


@st.composite
def tables(draw: st.DrawFn) -> tuple[CompensationTable, tuple[float, float, float]]:
    """Draw a smooth table of a few nodes anywhere, and one of its nodes as reference point."""
    shape = tuple(draw(st.integers(2, 6)) for _ in range(3))
    step = draw(st.sampled_from([12.5, 50.0, 100.0]))
    first = [step * draw(st.integers(-20, 20)) for _ in range(3)]
    nodes = [low + step * np.arange(count, dtype=np.float64) for low, count in zip(first, shape, strict=True)]
    rng = np.random.default_rng(draw(st.integers(0, 10**6)))
    corrections = 1e-3 * np.round(rng.uniform(-15.0, 15.0, (*shape, 3)), 4)
    x, y, z = (float(line[draw(st.integers(0, len(line) - 1))]) for line in nodes)
    marks = np.zeros(shape, dtype=bool)
    tool = rng.uniform(-200.0, 200.0, 3)
    along_x, along_y, along_z = nodes
    anchor = Anchor(np.array([x, y, z]))
    return CompensationTable(along_x, along_y, along_z, corrections, tool, anchor, marks), (x, y, z)


def points_in(table: CompensationTable) -> np.ndarray:
    low, high = np.array([(line[0], line[-1]) for line in table.nodes]).T
    return np.random.default_rng(5).uniform(low - 20.0, high + 20.0, (25, 3))


@pytest.mark.parametrize("name", sorted(set(FORMATS) - {"isg-volcomp", "linuxcnc-matrixkins", "klipper-skew"}))
@settings(max_examples=12, deadline=None)
@given(tables())
def test_a_controller_adds_what_is_said(name: str, drawn: tuple) -> None:
    table, reference = drawn
    one: ControllerExport = FORMATS[name].export(ExportSource(table), ExportOptions({"reference_mm": reference}))
    rule = rule_at(name, one.files, reference)
    at = points_in(table) if name != "fanuc-pitch" else np.array(np.meshgrid(*table.nodes)).reshape(3, -1).T
    assert rule(at) == pytest.approx(one.correction(at), abs=2e-6)
    if name not in ("gcode-csv", "neutral"):
        assert one.correction(np.array([reference]))[0] == pytest.approx(np.zeros(3), abs=1.1e-4)


@settings(max_examples=12, deadline=None)
@given(st.sampled_from(CHAINS), st.integers(0, 10**6), st.integers(0, 7))
def test_error_motions_are_read_back_for_every_chain(chain: str, seed: int, corner: int) -> None:
    """Compare the kernel's product of transforms with the table; they agree to some nanometres at the nodes."""
    rng = np.random.default_rng(seed)
    ranges = ((-300.0, 500.0), (0.0, 400.0), (-600.0, -200.0))
    model = ErrorModel.uniform(parse_chain(chain), ranges, 3, ("b0", "b1", "b2", "c0", "c1"))
    size = np.array([4e-3 if one.unit == "mm" else 6e-6 for one in model.parameters])
    source = source_of(model, size * rng.uniform(-1.0, 1.0, model.size), tool=rng.uniform(-300.0, 300.0, 3))
    table = source.table
    assert table.anchor.point_mm == pytest.approx([-300.0, 0.0, -600.0])
    rule = RULES["isg-volcomp"](FORMATS["isg-volcomp"].export(source, ExportOptions()).files)
    nodes = np.array(np.meshgrid(*table.nodes, indexing="ij")).reshape(3, -1).T[corner::31]
    assert rule(nodes) == pytest.approx(table.at(nodes), abs=2e-5)
