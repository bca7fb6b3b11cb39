"""The command gives the same table however the same measurement is written down, and speaks in the file's numbers."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from foreign_files import Folder

from campaigns.foreign.artefact import S3, ForeignBar, measure, tilted_bar
from campaigns.foreign.files import Row, rows_of
from campaigns.foreign.machine import foreign_machine
from twin.machine.rigid_motion import rigid_fields

COORDINATES = ("x_mm", "y_mm", "z_mm")
ORDER = ("--order", "4", "--json")
Measurement = tuple[ForeignBar, list[Row]]


@pytest.fixture(scope="module")
def measurement() -> Measurement:
    rng = np.random.default_rng(21)
    machine, bar = foreign_machine(rng), tilted_bar(rng)
    return bar, rows_of(measure(machine, bar, S3, rng).seen)


def table_of(folder: Folder, bar: ForeignBar, rows: list[Row]) -> tuple[np.ndarray, np.ndarray]:
    """Return the grid points (n, 3) in mm and the corrections (n, 3) in µm of the table that the command writes."""
    done = folder.run(bar, rows, *ORDER)
    assert done.exit_code == 0, done.output
    values = np.loadtxt(folder.out / "table.csv", delimiter=",", skiprows=1)
    return values[:, :3], values[:, 3:]


@pytest.fixture(scope="module")
def before(measurement: Measurement, tmp_path_factory: pytest.TempPathFactory) -> tuple[np.ndarray, np.ndarray]:
    return table_of(Folder(tmp_path_factory.mktemp("before")), *measurement)


def assert_same(found: np.ndarray, before: np.ndarray) -> None:
    """The limit is 1e-6 of the largest correction, but not less than two units of the last digit in the file."""
    assert np.abs(found - before).max() <= max(1e-6 * np.abs(before).max(), 2.01e-4)


def moved_by(rows: list[Row], low_mm: tuple[float, float, float]) -> list[Row]:
    return [
        {**row, **{name: f"{float(row[name]) + low:.7f}" for name, low in zip(COORDINATES, low_mm, strict=True)}}
        for row in rows
    ]


def test_zeros_of_the_axes(measurement: Measurement, before: tuple[np.ndarray, np.ndarray], tmp_path: Path) -> None:
    """Y and Z begin at 5000 mm. The anchor of the table, where it is zero, remains at the lower ends of the ranges."""
    bar, rows = measurement
    low = (0.0, 5000.0, 5000.0)
    points, corrections = table_of(Folder(tmp_path, low), bar, moved_by(rows, low))
    assert points == pytest.approx(before[0] + np.array(low), abs=1e-9)
    assert_same(corrections, before[1])


def test_zeros_within_the_ranges(
    measurement: Measurement, before: tuple[np.ndarray, np.ndarray], tmp_path: Path
) -> None:
    """The anchor is at the zeros of the axes if these are within the ranges. Another anchor is a rigid motion."""
    bar, rows = measurement
    low = (-1000.0, 200.0, -1500.0)
    points, corrections = table_of(Folder(tmp_path, low), bar, moved_by(rows, low))
    assert points == pytest.approx(before[0] + np.array(low), abs=1e-9)
    motions = rigid_fields(before[0], before[0].mean(axis=0), 4000.0).reshape(-1, 6)
    change = (corrections - before[1]).ravel()
    assert np.abs(change).max() > 1.0
    left = change - motions @ np.linalg.lstsq(motions, change, rcond=None)[0]
    assert np.abs(left).max() < 1e-3


def test_order_of_rows_and_numbers_of_positions(
    measurement: Measurement, before: tuple[np.ndarray, np.ndarray], tmp_path: Path
) -> None:
    bar, rows = measurement
    renumbered = [{**row, "position": str(900 - 7 * int(row["position"]))} for row in reversed(rows)]
    points, corrections = table_of(Folder(tmp_path), bar, renumbered)
    assert (points == before[0]).all()
    assert_same(corrections, before[1])


def test_rejected_balls_have_the_numbers_of_the_file(measurement: Measurement, tmp_path: Path) -> None:
    """Positions are numbered 900, 893, ... in the file, and ball 3 of one of them is 60 µm off."""
    bar, rows = measurement
    numbered = [{**row, "position": str(900 - 7 * int(row["position"]))} for row in rows]
    wrong = next(k for k, row in enumerate(numbered) if row["ball"] == "3" and int(row["position"]) < 880)
    numbered[wrong] = {**numbered[wrong], "y_mm": f"{float(numbered[wrong]['y_mm']) + 0.06:.6f}"}
    folder, number = Folder(tmp_path), int(numbered[wrong]["position"])
    done = folder.run(bar, numbered, *ORDER, report=True)
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout.splitlines()[0])["rejected"] == [[number, 3, 0]]
    stored = json.loads((folder.out / "estimate.json").read_text())
    assert stored["rejected"] == [{"position": number, "ball": 3, "tool": 0}]
    report = (folder.out / "report.html").read_text()
    assert f'data-head="position">{number}</td>' in report
