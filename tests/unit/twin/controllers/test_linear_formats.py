"""Formats that correct by a constant matrix: scales and squareness, by arithmetic of their own."""

from __future__ import annotations

import numpy as np
import pytest
from controller_rules import RULES
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.compensation.controllers.export_format import ExportSource
from twin.compensation.controllers.format_options import ExportOptions
from twin.compensation.controllers.registry import FORMATS
from twin.compensation.table import CompensationTable
from twin.errors import DataError
from twin.machine.anchor import Anchor

LINEAR = ("linuxcnc-matrixkins", "klipper-skew")
ENTRY = st.floats(-2e-4, 2e-4)
X, Y, Z = np.linspace(-100.0, 300.0, 5), np.linspace(0.0, 200.0, 3), np.linspace(-400.0, 0.0, 4)
PLACES = np.array([[x, y, z] for x in X for y in Y for z in Z])


def table_of(corrections: np.ndarray) -> ExportSource:
    grid = corrections.reshape(5, 3, 4, 3)
    marks = np.zeros((5, 3, 4), dtype=bool)
    return ExportSource(CompensationTable(X, Y, Z, grid, np.zeros(3), Anchor(np.zeros(3)), marks))


def moved(name: str, source: ExportSource) -> np.ndarray:
    """Return what the controller adds at the places, and check the statement of the export."""
    one = FORMATS[name].export(source, ExportOptions())
    added = RULES[name](one.files)(PLACES)
    assert added == pytest.approx(one.correction(PLACES), abs=1e-6)
    return added


@settings(max_examples=30, deadline=None)
@given(st.lists(ENTRY, min_size=9, max_size=9), st.tuples(ENTRY, ENTRY, ENTRY))
def test_matrixkins_adds_every_linear_field_but_its_constant(entries: list[float], constant: tuple) -> None:
    matrix = np.array(entries).reshape(3, 3)
    if np.abs(matrix + matrix.T).max() < 1e-5:
        matrix[0, 0] = 1e-4
    added = moved("linuxcnc-matrixkins", table_of(PLACES @ matrix.T + constant))
    for place, correction in zip(PLACES, added, strict=True):
        for row in range(3):
            assert correction[row] == pytest.approx(sum(matrix[row, n] * place[n] for n in range(3)), abs=1e-8)


@settings(max_examples=30, deadline=None)
@given(*([st.floats(1e-5, 2e-4)] * 3), ENTRY, ENTRY, ENTRY)
def test_klipper_makes_axes_square_that_lean(xy: float, xz: float, yz: float, a: float, b: float, c: float) -> None:
    """The true axes lean by the given angles, and the workspace is turned: scalar products of the axes tell."""
    turn = np.array([[0.0, -c, b], [c, 0.0, -a], [-b, a, 0.0]])
    shear = np.array([[0.0, xy, xz], [0.0, 0.0, yz], [0.0, 0.0, 0.0]])
    source = table_of(PLACES @ (turn - shear).T)
    moved("klipper-skew", source)
    rule = RULES["klipper-skew"](FORMATS["klipper-skew"].export(source, ExportOptions()).files)
    commands = 100.0 * np.vstack([np.zeros(3), np.eye(3)])
    motors = commands + rule(commands)
    tips = motors + motors @ shear.T
    along = tips[1:] - tips[0]
    for first, second in ((0, 1), (0, 2), (1, 2)):
        assert abs(float(along[first] @ along[second])) / 1e4 < 3e-7, "2e-4 squared, and rounding"


@pytest.mark.parametrize("name", LINEAR)
def test_a_machine_without_linear_errors_is_refused_with_the_share(name: str) -> None:
    bend = np.zeros_like(PLACES)
    bend[:, 1] = 1e-7 * (PLACES[:, 0] - 100.0) ** 2
    with pytest.raises(DataError, match=r"can apply only 0 % of this table's corrections") as caught:
        FORMATS[name].export(table_of(bend), ExportOptions())
    assert "a table" in caught.value.hint


def test_scale_is_nothing_for_skew_factors() -> None:
    with pytest.raises(DataError, match="skew_correction can apply only 0 %"):
        FORMATS["klipper-skew"].export(table_of(1e-4 * PLACES), ExportOptions())


@pytest.mark.parametrize("name", LINEAR)
def test_the_share_of_a_mixed_table_is_stated(name: str) -> None:
    """A shear of 0.1 mm/m over Y has the rms of its parts; the bend is even in X, thus orthogonal to it."""
    field = np.zeros_like(PLACES)
    field[:, 0] = 1e-4 * PLACES[:, 1]
    field[:, 2] = 1e-7 * (PLACES[:, 0] - 100.0) ** 2
    facts = FORMATS[name].export(table_of(field), ExportOptions()).facts
    ys, xs = PLACES[:, 1] - 100.0, PLACES[:, 0] - 100.0
    shear = 5e-5 * np.hypot(ys, xs)
    bend = 1e-7 * (xs**2 - np.mean(xs**2))
    half = np.mean(bend**2) / (np.mean(bend**2) + np.mean(shear**2) - _turn(xs, ys))
    assert facts["linear_share_percent"] == pytest.approx(100.0 * (1.0 - np.sqrt(half)), abs=0.6)


def _turn(xs: np.ndarray, ys: np.ndarray) -> float:
    """Return the mean square that a turn about Z takes from the symmetric shear, which is none for a square."""
    shear, turn = np.column_stack([5e-5 * ys, 5e-5 * xs]).ravel(), np.column_stack([-ys, xs]).ravel()
    return float((shear @ turn) ** 2 / (turn @ turn) / len(xs))
