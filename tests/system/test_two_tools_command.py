"""`volcal identify` with a ball file of two tools: what the second tool shows, and a table for either."""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from hidden_machine import ARTEFACT_FILE, MACHINE_FILE, HiddenMachine, as_csv, hidden_machine, measured_rows
from volcal_command import volcal_json

from twin.artefact.position_set import parse_position_set
from twin.compensation.table_file import parse_table
from twin.machine.volumetric import evaluation_grid, volumetric_error

OFFSETS = {"probe": np.array([0.0, 250.0, 0.0]), "side": np.array([150.0, 450.0, 0.0])}


@dataclass(frozen=True)
class Measured:
    folder: Path
    machines: dict[str, HiddenMachine]
    rows: dict[str, list[dict]]

    def identify(self, out: str, rows: list[dict], *more: str) -> dict:
        balls = self.folder / f"{out}.csv"
        balls.write_text(as_csv(rows))
        files = ("--machine", self.folder / "m.toml", "--artefact", ARTEFACT_FILE, "--out", self.folder / out)
        options = ("--order", "5", "--temperature-uncertainty", "0.1", *more)
        return volcal_json("identify", balls, *files, *options)

    def left_um(self, out: str, tool: str) -> tuple[float, float]:
        """True VE of the machine with a tool, without and with the table that stands in `out`."""
        folder, machine = self.folder / out, self.machines[tool]
        table = parse_table((folder / "table.csv").read_text(), (folder / "table.json").read_text(), "csv", "json")
        x, y, z = ((low + 1.0, high - 1.0) for low, high in machine.description.model.ranges_mm)
        grid = evaluation_grid((x, y, z), (21, 9, 9))
        correction = table.at(grid)
        bare, left = machine.deviation(grid), correction + machine.deviation(grid + correction)
        points = grid + machine.offset
        return volumetric_error(points, bare).aligned_um, volumetric_error(points, left).aligned_um


@pytest.fixture(scope="module")
def night(tmp_path_factory: pytest.TempPathFactory) -> Measured:
    """S3 with either tool; the artefact is put up anew for the second one, so its positions count on."""
    folder = tmp_path_factory.mktemp("two-tools")
    shutil.copy(MACHINE_FILE.parent / "case-study-deflection.csv", folder)
    side = f"[tools.side]\noffset_mm = {OFFSETS['side'].tolist()}\n\n[model]"
    (folder / "m.toml").write_text(MACHINE_FILE.read_text().replace("[model]", side, 1))
    rng = np.random.default_rng(12)
    straight = hidden_machine(rng)
    machines = {name: replace(straight, offset=offset) for name, offset in OFFSETS.items()}
    positions = parse_position_set("S3", 4)
    rows = {name: measured_rows(machine, positions, rng) for name, machine in machines.items()}
    for row in rows["side"]:
        row |= {"tool": "side", "position": str(int(row["position"]) + len(positions))}
    return Measured(folder, machines, rows)


def test_the_second_tool_shows_more(night: Measured) -> None:
    one = night.identify("one", night.rows["probe"], "--no-report")
    both = night.identify("both", [*night.rows["probe"], *night.rows["side"]])
    assert both["balls"] == len(night.rows["probe"]) + len(night.rows["side"])
    # turns of the Y carriage about the line through both tool points stay: five orders
    assert (one["rank"], both["rank"], both["parameters"]) == (70, 85, 90)
    assert json.loads((night.folder / "one" / "estimate.json").read_text())["tool_offsets_mm"] == [[0.0, 250.0, 0.0]]
    offsets = json.loads((night.folder / "both" / "estimate.json").read_text())["tool_offsets_mm"]
    assert offsets == [offset.tolist() for offset in OFFSETS.values()]
    assert "Measured with 2 tool offsets" in (night.folder / "both" / "report.html").read_text()


@pytest.mark.parametrize("tool", OFFSETS)
def test_the_table_of_either_tool_betters_the_true_machine_with_it(night: Measured, tool: str) -> None:
    said = night.identify(f"for-{tool}", [*night.rows["probe"], *night.rows["side"]], "--tool", tool, "--no-report")
    side_file = json.loads((night.folder / f"for-{tool}" / "table.json").read_text())
    assert side_file["tool_offset_mm"] == OFFSETS[tool].tolist()
    bare, left = night.left_um(f"for-{tool}", tool)
    assert bare > 6.0
    assert left < 0.4 * bare
    assert 0.4 < left / said["predicted_vce_um"] < 1.8
