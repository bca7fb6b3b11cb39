"""The library `import volcal`: its examples run, its pages are current, and importing it loads nothing else."""

from __future__ import annotations

import doctest
import gzip
import re
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import volcal
from twin.errors import FormatError
from twin.machine.volumetric import evaluation_grid, rigid_part
from volcal.reference import PREAMBLE, SECTIONS, page

ROOT = Path(__file__).resolve().parents[3]
HOW_TO = ROOT / "docs" / "how-to" / "use-volcal-in-a-notebook.md"
REFERENCE = ROOT / "docs" / "reference" / "python-api.md"


@pytest.fixture(scope="module")
def names(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, Any]:
    """The names with which the examples of the reference page start."""
    found: dict[str, Any] = {}
    exec("\n".join(line.removeprefix(">>> ") for line in PREAMBLE.splitlines()), found)  # noqa: S102  our own text
    return {**found, "folder": tmp_path_factory.mktemp("results")}


@pytest.mark.parametrize("module", SECTIONS)
def test_examples_of_the_docstrings_run(module: str, names: Mapping[str, Any]) -> None:
    result = doctest.testmod(import_module(module), extraglobs=dict(names))
    assert result.attempted > 0
    assert result.failed == 0


def test_the_reference_page_is_current() -> None:
    assert REFERENCE.read_text(encoding="utf-8") == page(), "run `make reference`"


def test_the_notebook_page_runs(tmp_path: Path) -> None:
    """Exactly the first block of the page, in a process and an empty directory of its own."""
    match = re.search(r"^```python\n(.*?)^```", HOW_TO.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    assert match is not None
    assert len([line for line in match[1].splitlines() if line]) <= 10
    done = subprocess.run([sys.executable, "-c", match[1]], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert re.fullmatch(r"VE \d+\.\d µm, expected after compensation \d+\.\d µm\n", done.stdout)
    assert (tmp_path / "error-map.png").read_bytes().startswith(b"\x89PNG")
    assert volcal.read_table(tmp_path / "table.csv").corrections.shape[3] == 3


def test_import_loads_no_mathematics_and_neither_agent_nor_simulators() -> None:
    program = "import sys, volcal; print(*sorted({name.partition('.')[0] for name in sys.modules}))"
    loaded = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout.split()
    unwanted = {"numpy", "scipy", "pydantic", "matplotlib", "twin", "agent", "simulators", "drivers"}
    assert unwanted.isdisjoint(loaded)


def test_using_it_loads_neither_agent_nor_simulators_nor_matplotlib() -> None:
    program = "import sys, volcal\nfor name in volcal.__all__: getattr(volcal, name)\nprint(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout.split()
    assert {"agent", "simulators", "drivers", "matplotlib"}.isdisjoint(loaded)


def test_an_unknown_name_is_refused() -> None:
    with pytest.raises(AttributeError, match="no attribute 'calibrate'"):
        _ = volcal.calibrate


def test_the_shipped_balls_are_those_of_the_simulation() -> None:
    setup = volcal.case_study()
    shipped = volcal.read_balls(volcal.shipped_file("examples/case-study-balls.csv"), setup.machine)
    simulated = volcal.simulate(setup, "S3", seed=1).balls
    difference = shipped.observations.axis_positions - simulated.observations.axis_positions
    assert np.abs(difference).max() < 1e-6


def test_what_is_written_is_read_back(tmp_path: Path, names: Mapping[str, Any]) -> None:
    setup, balls, estimate = names["setup"], names["balls"], names["estimate"]
    again = volcal.read_balls(volcal.write_balls(balls, setup.machine, tmp_path / "balls.csv"), setup.machine)
    np.testing.assert_allclose(again.observations.axis_positions, balls.observations.axis_positions, atol=1e-7)
    assert volcal.read_positions(volcal.write_positions(balls.positions, tmp_path / "set.csv")) == balls.positions
    stored = volcal.read_estimate(volcal.write_estimate(estimate, tmp_path / "estimate.json"))
    np.testing.assert_array_equal(stored.parameters, estimate.parameters)
    (tmp_path / "estimate.json.gz").write_bytes(gzip.compress((tmp_path / "estimate.json").read_bytes()))
    (tmp_path / "estimate.json").unlink()
    for name in ("estimate.json", "estimate.json.gz"):  # of a run that was compacted
        np.testing.assert_array_equal(volcal.read_estimate(tmp_path / name).parameters, estimate.parameters)
    (tmp_path / "estimate.json.gz").write_bytes(gzip.compress(b"{}")[:-1])
    with pytest.raises(FormatError, match=r"damaged .*estimate\.json"):
        volcal.read_estimate(tmp_path / "estimate.json")
    table = volcal.compensation_table(stored, balls)
    np.testing.assert_array_equal(table.corrections, volcal.compensation_table(estimate, balls).corrections)
    read = volcal.read_table(volcal.write_table(table, tmp_path / "table.csv"))
    np.testing.assert_allclose(read.corrections, table.corrections, atol=1e-7)


def test_the_prediction_agrees_with_the_true_machine() -> None:
    """Normalised by its covariance, the error of a prediction is that of a normal deviate."""
    setup = volcal.case_study()
    simulation = volcal.simulate(setup, "S1+S3", seed=5, deflection="as modelled")
    estimate = volcal.identify(simulation.balls, setup.machine, setup.artefact, order="file")
    points = np.random.default_rng(1).uniform([0.0, 0.0, 0.0], [4000.0, 1300.0, 1500.0], (40, 3))
    prediction = volcal.predict(estimate, points)
    grid, offset = evaluation_grid(setup.machine.model.ranges_mm), np.array(estimate.tool_offsets[0])
    rigid = rigid_part(grid + offset, simulation.true_error(grid), points + offset)
    wrong = simulation.true_error(points) - rigid - prediction.error_mm
    assert np.sqrt(np.mean((wrong / prediction.standard_uncertainty_mm) ** 2)) < 2.0


def test_the_aligned_prediction_contains_no_rigid_motion(names: Mapping[str, Any]) -> None:
    estimate = names["estimate"]
    grid, offset = evaluation_grid(estimate.model.ranges_mm), np.array(estimate.tool_offsets[0])
    error = np.concatenate([volcal.predict(estimate, part).error_mm for part in np.array_split(grid, 40)])
    assert np.abs(rigid_part(grid + offset, error, grid + offset)).max() < 1e-12


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("position,station\n", ["balls.csv", "column 'azimuth_deg' is missing", "row 1"]),
        (
            "position,station,azimuth_deg,elevation_deg,tool,ball,x_mm,y_mm,z_mm,sigma_um,temperature_c\n"
            "0,1,45,0,probe,0,left,2,3,1,20\n",
            ["balls.csv", "row 2", "column x_mm", "'left'"],
        ),
    ],
)
def test_errors_name_file_and_row(tmp_path: Path, text: str, words: list[str]) -> None:
    path = tmp_path / "balls.csv"
    path.write_text(text)
    with pytest.raises(volcal.FormatError) as caught:
        volcal.read_balls(path, volcal.case_study().machine)
    assert [word for word in words if word not in str(caught.value)] == []


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(volcal.FormatError, match=r"there is no such file .*nowhere\.toml"):
        volcal.read_machine(tmp_path / "nowhere.toml")
    with pytest.raises(volcal.FormatError, match=r"case-study\.toml"):
        volcal.shipped_file("machines/another.toml")


def test_wrong_choices_say_what_is_known(tmp_path: Path, names: Mapping[str, Any]) -> None:
    table = volcal.compensation_table(names["estimate"], names["balls"])
    with pytest.raises(volcal.DataError, match="siemens-cec"):
        volcal.export_table(table, "siemens", tmp_path)
    with pytest.raises(volcal.DataError, match="has no option 'colour'"):
        volcal.export_table(table, "neutral", tmp_path, colour="red")
    with pytest.raises(volcal.DataError, match="count or target_vce_um"):
        volcal.design(names["setup"])
    with pytest.raises(volcal.DataError, match="beams"):
        volcal.simulate(names["setup"], deflection="rubber")


def test_an_export_that_cannot_be_written_in_full_leaves_the_files_before(
    tmp_path: Path, names: Mapping[str, Any]
) -> None:
    table = volcal.compensation_table(names["estimate"], names["balls"])
    first, *_, last = volcal.export_table(table, "linuxcnc-comp", tmp_path / "whole").files
    (tmp_path / last).mkdir()
    (tmp_path / first).write_text("of the table before", encoding="utf-8")
    with pytest.raises(IsADirectoryError, match=last):
        volcal.export_table(table, "linuxcnc-comp", tmp_path)
    assert (tmp_path / first).read_text(encoding="utf-8") == "of the table before"
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([first, last, "whole"])


def test_a_text_that_cannot_be_encoded_leaves_the_file_before(tmp_path: Path) -> None:
    file = volcal.write_positions((volcal.Position(1, 0.0, 45.0),), tmp_path / "set.csv")
    before = file.read_bytes()
    with pytest.raises(UnicodeEncodeError):
        volcal.write_positions((volcal.Position(2, 0.0, 45.0, tool="long\ud800"),), file)
    assert file.read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["set.csv"]


def test_a_thermometer_is_never_exact_unless_it_is_stated(names: Mapping[str, Any]) -> None:
    """The second night knows the thermometer of the first one, but not a temperature that was not read."""
    setup, read = names["setup"], names["balls"]
    unread = replace(read, temperature_was_read=False)

    def used_k(balls: volcal.BallFile, **stated: Any) -> float:
        options = volcal.Options(estimate_scales=False, outliers="none", **stated)
        found = volcal.identify(balls, setup.machine, setup.artefact, order="file", options=options)
        return found.unknowns.artefact.thermometer_standard_uncertainty_k

    assert (used_k(read), used_k(unread)) == (1.0, 3.0)
    assert used_k(read, temperature_standard_uncertainty_k=0.0) == 0.0
    options = volcal.Options(estimate_scales=False, outliers="none", temperature_standard_uncertainty_k=0.2)
    known = volcal.identify(read, setup.machine, setup.artefact, order="file", options=options).carried_over()
    assert (used_k(read, carried_over=known), used_k(unread, carried_over=known)) == (0.2, 3.0)


def test_a_distance_error_is_that_of_the_predicted_errors_and_does_not_depend_on_the_alignment(
    names: Mapping[str, Any],
) -> None:
    estimate = names["estimate"]
    ends = [[500.0, 300.0, 400.0], [3500.0, 900.0, 400.0]]
    aligned = volcal.predict(estimate, ends)
    unaligned = volcal.predict_unaligned(estimate, ends, volcal.RigidMotionUncertainty(0.01, 0.0))
    error_mm, sigma_mm = aligned.distance_error(0, 1)
    points = (aligned.points_mm + aligned.error_mm, ends)
    produced, nominal = (np.linalg.norm(np.diff(two, axis=0)) for two in points)
    assert error_mm == pytest.approx(produced - nominal, abs=1e-6)
    assert unaligned.distance_error(1, 0)[0] == pytest.approx(error_mm, abs=1e-9)
    assert unaligned.distance_error(0, 1)[1] == pytest.approx(sigma_mm, rel=0.05)


@pytest.mark.parametrize(("first", "second"), [(0, 2), (-1, 0), (0, 0)])
def test_a_distance_needs_two_points(names: Mapping[str, Any], first: int, second: int) -> None:
    prediction = volcal.predict(names["estimate"], [[0.0, 0.0, 0.0], [100.0, 0.0, 0.0]])
    with pytest.raises(volcal.DataError):
        prediction.distance_error(first, second)


def test_the_same_machine_is_measured_again_with_the_same_artefact(names: Mapping[str, Any]) -> None:
    first = volcal.simulate(names["setup"], "S1", seed=3)
    same, changed = first.measure_again("S1", seed=4), first.measure_again("S1", seed=4, change=0.5)
    assert same.true_machine is first.true_machine
    assert same.true_artefact is changed.true_artefact is first.true_artefact
    noise, difference = (
        np.abs(one.balls.observations.axis_positions - first.balls.observations.axis_positions).max()
        for one in (same, changed)
    )
    assert noise > 0.0
    assert not np.isclose(difference, noise)
    np.testing.assert_array_equal(
        same.balls.observations.axis_positions, first.measure_again("S1", seed=4).balls.observations.axis_positions
    )
    with pytest.raises(volcal.DataError, match="change"):
        first.measure_again("S1", change=-0.1)


def test_the_remaining_error_of_a_table_is_that_of_its_lossless_export(
    names: Mapping[str, Any], tmp_path: Path
) -> None:
    setup = names["setup"]
    simulation = volcal.simulate(setup, "S3", seed=2)
    estimate = volcal.identify(simulation.balls, setup.machine, setup.artefact, order=5)
    table = volcal.compensation_table(estimate, simulation.balls)
    export = volcal.export_table(table, "neutral", tmp_path)
    points = np.random.default_rng(1).uniform([0.0, 0.0, 0.0], [4000.0, 1300.0, 1500.0], (50, 3))
    without, with_table, with_export = (
        simulation.true_error(points, table=one, aligned=True) for one in (None, table, export)
    )
    np.testing.assert_allclose(with_export, with_table, atol=1e-4)
    assert np.sqrt(np.mean(with_table**2)) < 0.9 * np.sqrt(np.mean(without**2))
