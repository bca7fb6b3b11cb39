"""Ball files that cannot be right are refused by `volcal identify`, with file, row or position, and a remedy."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from foreign_files import Folder

from campaigns.foreign.artefact import S3, ForeignBar, measure, straight_bar, tilted_bar
from campaigns.foreign.files import Row, rows_of
from campaigns.foreign.machine import TOOL, foreign_machine

Bars = dict[str, tuple[ForeignBar, list[Row]]]
MAKERS: dict[str, Callable[[np.random.Generator], ForeignBar]] = {
    "tilted": tilted_bar,
    "straight": lambda rng: straight_bar(rng, 0.005),
}
AXES = ("x_mm", "y_mm", "z_mm")


@pytest.fixture(scope="module")
def bars() -> Bars:
    found = {}
    for name, make in MAKERS.items():
        rng = np.random.default_rng(17)
        machine, bar = foreign_machine(rng), make(rng)
        found[name] = bar, rows_of(measure(machine, bar, S3, rng).seen)
    return found


@pytest.fixture
def folder(tmp_path: Path) -> Folder:
    return Folder(tmp_path)


def moved(rows: list[Row], change: Callable[[np.ndarray], np.ndarray]) -> list[Row]:
    """Return the rows with changed coordinates (n, 3)."""
    points = change(np.array([[float(row[axis]) for axis in AXES] for row in rows]))
    texts = [dict(zip(AXES, (f"{value:.6f}" for value in point), strict=True)) for point in points.tolist()]
    return [{**row, **text} for row, text in zip(rows, texts, strict=True)]


def refused(folder: Folder, bar: ForeignBar, rows: list[Row], *words: str) -> str:
    """Assert that the file is refused with one line that contains `words`, and that nothing is written."""
    done = folder.run(bar, rows, "--order", "4")
    assert done.exit_code == 2, done.output
    message = done.stderr
    assert message.startswith("error: ")
    assert len(message.strip().splitlines()) == 1
    for word in ("balls.csv", *words):
        assert word in message, message
    assert not folder.out.exists()
    return message


@pytest.mark.parametrize("name", sorted(MAKERS))
def test_a_file_without_a_fault_is_accepted(name: str, bars: Bars, folder: Folder) -> None:
    bar, rows = bars[name]
    done = folder.run(bar, rows, "--order", "4")
    assert done.exit_code == 0, done.output


class TestOutsideTheTravel:
    def test_micrometres_for_millimetres(self, bars: Bars, folder: Folder) -> None:
        bar, rows = bars["tilted"]
        refused(folder, bar, moved(rows, lambda x: 1e3 * x), "row 2, column x_mm", "0 to 4000 mm", "give mm")

    def test_tool_offset_added(self, bars: Bars, folder: Folder) -> None:
        bar, rows = bars["tilted"]
        message = refused(folder, bar, moved(rows, lambda x: x + TOOL), "travel of Y", "column y_mm")
        assert "without the tool offset" in message

    def test_shifted_frame(self, bars: Bars, folder: Folder) -> None:
        bar, rows = bars["tilted"]
        shifted = moved(rows, lambda x: x - np.array([2000.0, 0.0, 0.0]))
        refused(folder, bar, shifted, "travel of X", "frame is shifted")

    def test_one_row_with_a_digit_too_many(self, bars: Bars, folder: Folder) -> None:
        bar, rows = bars["tilted"]
        wrong = [dict(row) for row in rows]
        wrong[40]["z_mm"] = "9" + wrong[40]["z_mm"]
        refused(folder, bar, wrong, "row 42, column z_mm", "travel of Z")

    def test_other_sign(self, bars: Bars, folder: Folder) -> None:
        bar, rows = bars["straight"]
        refused(folder, bar, moved(rows, lambda x: x * np.array([1.0, 1.0, -1.0])), "travel of Z", "other sign of Z")


class TestShapeOfTheArtefact:
    @pytest.mark.parametrize("name", sorted(MAKERS))
    @pytest.mark.parametrize(("factor", "unit"), [(1.0 / 25.4, "inch"), (1e-3, "m:"), (0.1, "cm")])
    def test_other_units_inside_the_travel(
        self, name: str, factor: float, unit: str, bars: Bars, folder: Folder
    ) -> None:
        bar, rows = bars[name]
        refused(folder, bar, moved(rows, lambda x: factor * x), "times those of the certificate", f"look like {unit}")

    @pytest.mark.parametrize("axis", range(3))
    def test_mirrored_axis(self, axis: int, bars: Bars, folder: Folder) -> None:
        """The axis counts from its other end, so that all positions stay inside the travel."""
        bar, rows = bars["tilted"]
        length = np.array([4000.0, 1300.0, 1500.0])
        flip = np.arange(3) == axis
        refused(folder, bar, moved(rows, lambda x: np.where(flip, length - x, x)), "are a mirror image", "one axis")

    @pytest.mark.parametrize("axis", [0, 1])
    def test_mirrored_axis_of_a_straight_bar(self, axis: int, bars: Bars, folder: Folder) -> None:
        """The bar is its own mirror image, but it lies at other azimuths than the file states."""
        bar, rows = bars["straight"]
        length = np.array([4000.0, 1300.0, 1500.0])
        flip = np.arange(3) == axis
        refused(folder, bar, moved(rows, lambda x: np.where(flip, length - x, x)), "mirrored azimuths", "one axis")

    @pytest.mark.parametrize("name", sorted(MAKERS))
    @pytest.mark.parametrize("turned_deg", [30.0, 180.0])
    def test_a_mount_that_is_turned_about_z_is_no_mirror(
        self, name: str, turned_deg: float, bars: Bars, folder: Folder
    ) -> None:
        bar, rows = bars[name]
        azimuths = [(float(row["azimuth_deg"]) + turned_deg + 180.0) % 360.0 - 180.0 for row in rows]
        other = [{**row, "azimuth_deg": f"{azimuth:g}"} for row, azimuth in zip(rows, azimuths, strict=True)]
        assert folder.run(bar, other, "--order", "4").exit_code == 0

    @pytest.mark.parametrize("name", sorted(MAKERS))
    def test_ball_numbers_reversed_in_all_positions(self, name: str, bars: Bars, folder: Folder) -> None:
        bar, rows = bars[name]
        turned = [{**row, "ball": str(10 - int(row["ball"]))} for row in rows]
        refused(folder, bar, turned, "numbered from the other end of the artefact", "from 0")

    def test_ball_numbers_reversed_in_one_position(self, bars: Bars, folder: Folder) -> None:
        bar, rows = bars["tilted"]
        turned = [{**row, "ball": str(10 - int(row["ball"]))} if row["position"] == "5" else row for row in rows]
        refused(folder, bar, turned, "position 5 has its balls numbered from the other end")

    def test_a_symmetrical_certificate_cannot_tell(self, folder: Folder) -> None:
        """Each ball has its mirror image within the errors of the machine: nothing is refused."""
        rng = np.random.default_rng(3)
        machine, drawn = foreign_machine(rng), straight_bar(rng, 0.0)
        certified = 0.5 * (drawn.certified - drawn.certified[::-1] * np.array([1.0, -1.0, -1.0]))
        bar = ForeignBar(certified, certified + rng.normal(0.0, 0.8e-3, certified.shape), drawn.cte_per_k)
        rows = rows_of(measure(machine, bar, S3, rng).seen)
        turned = [{**row, "ball": str(10 - int(row["ball"]))} for row in rows]
        assert folder.run(bar, turned, "--order", "4").exit_code == 0


class TestStatedUncertainty:
    def test_millimetres_in_a_column_of_micrometres(self, bars: Bars, folder: Folder) -> None:
        bar, rows = bars["tilted"]
        refused(folder, bar, [{**row, "sigma_um": "0.001"} for row in rows], "row 2, column sigma_um", "like mm")

    def test_nanometres(self, bars: Bars, folder: Folder) -> None:
        bar, rows = bars["tilted"]
        refused(folder, bar, [{**row, "sigma_um": "1000"} for row in rows], "row 2, column sigma_um", "50 µm")

    @pytest.mark.parametrize("stated", ["0.05", "20"])
    def test_the_residuals_contradict_it(self, stated: str, bars: Bars, folder: Folder) -> None:
        bar, rows = bars["tilted"]
        wrong = [{**row, "sigma_um": stated} for row in rows]
        refused(folder, bar, wrong, f"rows 2 to {len(rows) + 1} state {stated} µm", "column sigma_um")


class TestGivenTwice:
    def test_every_row_under_another_position_number(self, bars: Bars, folder: Folder) -> None:
        bar, rows = bars["tilted"]
        again = [{**row, "position": str(int(row["position"]) + 100)} for row in rows]
        words = ("position 101 repeats position 1", "row 2 and row", f"row {len(rows) + 2}, column position")
        refused(folder, bar, rows + again, *words)

    def test_one_position_in_another_order(self, bars: Bars, folder: Folder) -> None:
        bar, rows = bars["straight"]
        copied = [{**row, "position": "99"} for row in rows if row["position"] == "4"][::-1]
        refused(folder, bar, rows + copied, "position 99 repeats position 4")

    def test_copy_with_disturbed_last_digits(self, bars: Bars, folder: Folder) -> None:
        bar, rows = bars["tilted"]
        rng = np.random.default_rng(5)
        copied = [{**row, "position": "99"} for row in rows if row["position"] == "4"]
        for row in copied:
            row.update({axis: repr(float(row[axis]) + rng.uniform(-2e-6, 2e-6)) for axis in AXES})
        refused(folder, bar, rows + copied, "position 99 repeats position 4")

    def test_one_ball_for_another(self, bars: Bars, folder: Folder) -> None:
        bar, rows = bars["tilted"]
        copied = [dict(row) for row in rows]
        copied[3].update({axis: copied[2][axis] for axis in AXES})
        wrong, real = copied[3]["ball"], copied[2]["ball"]
        message = f"position 1: ball {wrong} has the coordinates of ball {real} in row 4"
        refused(folder, bar, copied, message, "row 5, column ball")

    def test_balls_that_agree_by_chance_are_no_copy(self, bars: Bars, folder: Folder) -> None:
        """Two balls of two positions have the same coordinates; the others differ by the noise."""
        bar, rows = bars["tilted"]
        rng = np.random.default_rng(5)
        first = [row for row in rows if row["position"] == "4"]
        again = moved([{**row, "position": "99"} for row in first], lambda x: x + rng.normal(0.0, 1.4e-3, x.shape))
        again[2:4] = [{**row, "position": "99"} for row in first[2:4]]
        assert folder.run(bar, rows + again, "--order", "4").exit_code == 0
