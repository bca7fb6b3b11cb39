"""Draw docs/images/before-after.png: the true deviation of the demonstration's machine, known to the simulator only.

Run `volcal demo --out runs`, then `python docs/images/draw_truth.py runs/RUN_ID/table.csv before-after.png`.
The figure shows the true deviation of the scenario's machine without and with that run's table, rigid motion removed.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from agent.planning.case_file import SHIPPED_CONFIGURATION
from simulators.scenario import read_scenario
from simulators.world.world import true_machine
from twin.compensation.table_file import parse_table
from twin.machine.error_model import Ranges
from twin.machine.volumetric import align_rigidly, evaluation_grid, rms

Array = NDArray[np.float64]
Field = Callable[[Array], Array]

SCENARIO = SHIPPED_CONFIGURATION / "simulators" / "case-study.toml"
SHAPE = (81, 27, 3)


def main(table_csv: Path, out: Path) -> None:
    """Two rows, bare and compensated, three heights each, one colour scale."""
    scenario = read_scenario(SCENARIO)
    machine = true_machine(scenario)
    side = table_csv.with_suffix(".json")
    table = parse_table(table_csv.read_text(), side.read_text(), str(table_csv), str(side))
    bare, compensated = machine.deviation, _compensated(machine.deviation, table.at)
    ranges, offset = scenario.machine.model.ranges_mm, machine.tool_offset
    rows = [(title, *_lengths(field, ranges, offset)) for title, field in (("before", bare), ("after", compensated))]
    figure = Figure(figsize=(10.0, 2.9), layout="constrained")
    panels = figure.subplots(2, 3, sharex=True, sharey=True)
    top = max(float(length.max()) for _, length, _ in rows)
    for (title, length, value), row in zip(rows, panels, strict=True):
        for level, panel in enumerate(row):
            image = panel.imshow(
                length[:, :, level].T, origin="lower", extent=(*ranges[0], *ranges[1]), vmin=0.0, vmax=top
            )
            height = np.linspace(*ranges[2], SHAPE[2])[level]
            panel.set_title(f"{title}, Z = {height:g} mm", loc="left", fontsize=9)
        row[0].set_ylabel(f"VE {value:.1f} µm\n\nY / mm", fontsize=9)
    for panel in panels[-1]:
        panel.set_xlabel("X / mm", fontsize=9)
    figure.colorbar(image, ax=panels, label="true deviation / µm", pad=0.01, aspect=30)
    figure.savefig(out, dpi=120)


def _compensated(bare: Field, correction: Field) -> Field:
    """The drives go to the displayed position plus what the table adds; the machine errs there."""

    def field(displayed: Array) -> Array:
        added = correction(displayed)
        return added + bare(displayed + added)

    return field


def _lengths(field: Field, ranges: Ranges, offset: Array) -> tuple[Array, float]:
    """Lengths in µm over the planes less the rigid motion that fits the workspace best, and VE in µm, aligned."""
    grid, planes = evaluation_grid(ranges), evaluation_grid(ranges, SHAPE)
    both = np.concatenate((grid, planes))
    deviation = field(both)
    left = align_rigidly(grid + offset, deviation[: len(grid)])
    columns = _rigid(grid)
    motion = np.linalg.lstsq(columns.reshape(-1, 6), (deviation[: len(grid)] - left).reshape(-1), rcond=None)[0]
    shown = deviation[len(grid) :] - _rigid(planes) @ motion
    return 1e3 * np.linalg.norm(shown, axis=1).reshape(SHAPE), 1e3 * rms(left)


def _rigid(points: Array) -> Array:
    """Columns (n, 3, 6) of a small rigid motion: translations, then rotation × point."""
    columns = np.zeros((len(points), 3, 6))
    columns[:, :, :3] = np.eye(3)
    columns[:, :, 3:] = np.cross(np.eye(3)[None], points[:, None]).transpose(0, 2, 1)
    return columns


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
