"""The real command on real files: what it writes, and what it says when the input is wrong."""

from __future__ import annotations

import csv
import json
import shutil
import subprocess
import sys
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import Result
from hidden_machine import (
    ARTEFACT_FILE,
    COLUMNS,
    MACHINE_FILE,
    HiddenMachine,
    as_csv,
    ball_file,
    hidden_machine,
    measured_rows,
)
from scipy.interpolate import RegularGridInterpolator
from volcal_command import volcal

from twin.artefact.position_set import parse_position_set
from twin.machine.volumetric import evaluation_grid, volumetric_error

RUN = [
    sys.executable,
    "-c",
    "from agent.cli.offline_commands.identify import identify; identify(prog_name='volcal identify')",
]
ARTEFACT = ["artefact-covariance.csv", "artefact.toml"]
RESULTS = [*ARTEFACT, "estimate.json", "report.html", "table.csv", "table.json"]


def run(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [*RUN, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=600.0, check=False)


def here(*arguments: str | Path) -> Result:
    """Run the same command in this process, which saves the start of a separate one."""
    return volcal("identify", *arguments, exit_code=None)


def arguments(balls: Path, out: Path, machine: Path = MACHINE_FILE, artefact: Path = ARTEFACT_FILE) -> list[str]:
    files = [str(balls), "--machine", str(machine), "--artefact", str(artefact), "--out", str(out)]
    return [*files, "--temperature-uncertainty", "0.1"]


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, HiddenMachine, dict, Path]:
    folder = tmp_path_factory.mktemp("measured")
    machine = ball_file(folder / "balls.csv")
    done = run(*arguments(folder / "balls.csv", folder / "out"), "--json")
    assert done.returncode == 0, done.stderr
    return folder / "balls.csv", machine, json.loads(done.stdout), folder / "out"


class TestGoodInput:
    def test_the_json_object_has_the_agreed_keys(self, measured: tuple) -> None:
        balls, _machine, said, out = measured
        wanted = "state run_id position_set formulation balls touches machine_minutes wall_seconds rank parameters"
        wanted += " predicted_vce_um predicted_vce_raw_um verified table_bank report chi2_normalised rejected"
        assert set(wanted.split()) <= set(said)
        assert said["state"] == "complete"
        assert said["position_set"] == "S3, 4 stations"
        assert said["formulation"] == "centres"
        assert said["balls"] == len(balls.read_text().splitlines()) - 1
        assert (said["touches"], said["machine_minutes"], said["verified"], said["table_bank"]) == (None,) * 4
        assert said["report"] == str(out / "report.html")
        assert 0 < said["rank"] < said["parameters"]
        assert str(said["orders"]["EXX"]) in said["order_evidence"]

    def test_all_results_are_there_and_nothing_else(self, measured: tuple) -> None:
        out = measured[3]
        assert sorted(path.name for path in out.iterdir()) == RESULTS
        assert {"model", "parameters"} & set(json.loads((out / "estimate.json").read_text()))
        assert (out / "report.html").read_text().startswith("<!DOCTYPE html>")

    def test_the_table_makes_the_hidden_machine_better_within_the_prediction(self, measured: tuple) -> None:
        """The table read by an own reader, added to the commanded position of the machine as it really is."""
        _balls, machine, said, out = measured
        x, y, z = ((low + 1.0, high - 1.0) for low, high in machine.description.model.ranges_mm)
        grid = evaluation_grid((x, y, z), (21, 9, 9))  # the deflection is not known beyond the travel
        corrections = read_table(out / "table.csv")(grid)
        before = volumetric_error(grid + machine.offset, machine.deviation(grid))
        after = volumetric_error(grid + machine.offset, corrections + machine.deviation(grid + corrections))
        assert before.aligned_um > 6.0
        assert after.aligned_um < min(3.5, 0.5 * before.aligned_um)
        assert 0.4 < after.aligned_um / said["predicted_vce_um"] < 1.8
        assert before.aligned_um == pytest.approx(said["estimated_ve_um"], rel=0.25)

    def test_people_read_a_table(self, measured: tuple, tmp_path: Path) -> None:
        done = run(
            *arguments(measured[0], tmp_path / "out"), "--formulation", "distances", "--weights", "unit", "--even-so"
        )
        assert done.returncode == 0, done.stderr
        assert "predicted after compensation" in done.stdout
        assert str(tmp_path / "out" / "report.html") in done.stdout.replace("\n", "")
        written = sorted(path.name for path in (tmp_path / "out").iterdir())
        assert written == [name for name in RESULTS if name not in ARTEFACT]

    def test_the_gates_judge_by_the_limits_of_the_settings_file(self, measured: tuple, tmp_path: Path) -> None:
        """The same balls pass with the default limits, which are those of a run without a `[gates]` section."""
        said = measured[2]
        assert said["gates"]["redundancy"]
        assert said["gates"]["correction"]
        text = (MACHINE_FILE.parents[1] / "case-study.toml").read_text()
        strict = "[gates]\nmin_degrees_of_freedom = 100000\nmax_correction_um = 0.001\n"
        (tmp_path / "volcal.toml").write_text(f"{text}\n{strict}")
        config = ("--config", tmp_path / "volcal.toml")
        done = here(*arguments(measured[0], tmp_path / "out"), *config, "--order", "2", "--json")
        assert done.exit_code == 4, done.stderr
        gates = json.loads(done.stdout)["gates"]
        assert not gates["redundancy"]
        assert not gates["correction"]
        assert "redundant measurements: " in done.stderr
        assert "largest correction: " in done.stderr
        assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [*ARTEFACT, "estimate.json", "report.html"]

    def test_a_wrong_ball_is_found_and_named(self, tmp_path: Path) -> None:
        rng = np.random.default_rng(11)
        rows = measured_rows(hidden_machine(rng), parse_position_set("S3", 4), rng)
        rows[100]["y_mm"] = f"{float(rows[100]['y_mm']) + 0.05:.6f}"
        (tmp_path / "balls.csv").write_text(as_csv(rows))
        done = here(*arguments(tmp_path / "balls.csv", tmp_path / "out"), "--no-report", "--json")
        assert [int(rows[100]["position"]), int(rows[100]["ball"]), 0] in json.loads(done.stdout)["rejected"]

    def test_without_the_family_it_still_ends_well(self, measured: tuple, tmp_path: Path) -> None:
        options = ("--prior", "off", "--even-so", "--no-report", "--json")
        done = here(*arguments(measured[0], tmp_path / "out"), *options)
        assert done.exit_code == 0, done.stderr
        assert json.loads(done.stdout)["report"] is None
        assert not (tmp_path / "out" / "report.html").exists()
        assert np.isfinite(json.loads(done.stdout)["predicted_vce_um"])


def read_table(path: Path) -> Callable[[np.ndarray], np.ndarray]:
    """An own reader: x slowest, z fastest, µm; trilinear in between."""
    with path.open() as file:
        lines = [line for line in csv.reader(file) if line and not line[0].startswith("#")]
    assert lines[0] == ["x_mm", "y_mm", "z_mm", "dx_um", "dy_um", "dz_um"]
    values = np.array(lines[1:], dtype=float)
    nodes = [np.unique(values[:, axis]) for axis in range(3)]
    shape = tuple(len(node) for node in nodes)
    assert (np.lexsort(values[:, 2::-1].T) == np.arange(len(values))).all()
    return RegularGridInterpolator(nodes, 1e-3 * values[:, 3:].reshape(*shape, 3))


def edited(rows: list[dict], row: int, **cells: str) -> str:
    changed = [dict(line) for line in rows]
    changed[row].update(cells)
    return as_csv(changed)


@pytest.fixture(scope="module")
def rows() -> list[dict]:
    rng = np.random.default_rng(2)
    return measured_rows(hidden_machine(rng), parse_position_set("S3", 2), rng)


BAD_BALLS: dict[str, tuple[Callable[[list[dict]], str], list[str]]] = {
    "missing column": (lambda rows: as_csv(rows, [name for name in COLUMNS if name != "y_mm"]), ["y_mm"]),
    "not a number": (lambda rows: edited(rows, 3, x_mm="twelve"), ["x_mm", "5", "twelve"]),
    "NaN": (lambda rows: edited(rows, 3, z_mm="nan"), ["z_mm", "5"]),
    "duplicated ball": (lambda rows: as_csv([*rows, rows[0]]), ["already", str(0)]),
    "unknown tool": (lambda rows: edited(rows, 6, tool="long"), ["long", "8", "probe"]),
    "ball that the artefact does not have": (lambda rows: edited(rows, 6, ball="77"), ["77"]),
    "one position only": (
        lambda rows: as_csv([row for row in rows if row["position"] == "0"]),
        ["position"],
    ),
    "header only": (lambda rows: as_csv([]), ["ball"]),
    "empty": (lambda rows: "", ["position"]),
}


class TestBadInput:
    def refuse(self, done: Result, out: Path, *words: str) -> None:
        """One clear message, exit code 2, nothing written, nothing on stdout."""
        assert done.exit_code == 2, (done.exit_code, done.stdout, done.stderr)
        assert done.stdout == ""
        assert done.stderr.startswith("error: ")
        assert len(done.stderr.strip().splitlines()) == 1
        assert "Traceback" not in done.stderr
        for word in words:
            assert word in done.stderr
        assert not out.exists()

    @pytest.mark.parametrize("name", BAD_BALLS)
    def test_a_bad_ball_file(self, name: str, rows: list[dict], tmp_path: Path) -> None:
        make, words = BAD_BALLS[name]
        path = tmp_path / "balls.csv"
        path.write_text(make(rows))
        self.refuse(here(*arguments(path, tmp_path / "out"), "--json"), tmp_path / "out", str(path), *words)

    def test_one_position_only_without_the_family(self, rows: list[dict], tmp_path: Path) -> None:
        path = tmp_path / "balls.csv"
        path.write_text(BAD_BALLS["one position only"][0](rows))
        self.refuse(here(*arguments(path, tmp_path / "out"), "--prior", "off"), tmp_path / "out", str(path))

    @pytest.mark.parametrize(
        ("old", "new", "words"),
        [
            ("tool-Y-Z-X-bed-workpiece", "tool-Y-Z-bed-workpiece", ["X", "chain"]),
            ("[tools.probe]", 'colour = "red"\n[tools.probe]', ["colour"]),
            ("range_mm = [0.0, 4000.0]", "range_mm = [4000.0, 0.0]", ["X"]),
            ("case-study-deflection.csv", "lost.csv", ["lost.csv"]),
            ("[model]", "[model", ["line"]),
        ],
    )
    def test_a_bad_machine_file(self, old: str, new: str, words: list[str], measured: tuple, tmp_path: Path) -> None:
        shutil.copy(MACHINE_FILE.parent / "case-study-deflection.csv", tmp_path)
        text = MACHINE_FILE.read_text()
        assert old in text
        (tmp_path / "m.toml").write_text(text.replace(old, new, 1))
        done = here(*arguments(measured[0], tmp_path / "out", machine=tmp_path / "m.toml"))
        self.refuse(done, tmp_path / "out", *words)

    def test_an_unknown_key_of_the_artefact(self, measured: tuple, tmp_path: Path) -> None:
        (tmp_path / "a.toml").write_text("weight_kg = 3.0\n" + ARTEFACT_FILE.read_text())
        done = here(*arguments(measured[0], tmp_path / "out", artefact=tmp_path / "a.toml"))
        self.refuse(done, tmp_path / "out", "weight_kg", "a.toml")

    def test_a_missing_file(self, tmp_path: Path) -> None:
        given, words = arguments(tmp_path / "no.csv", tmp_path / "out"), ("no.csv", "no such file")
        self.refuse(here(*given), tmp_path / "out", *words)
        as_process = run(*given)
        assert (as_process.returncode, as_process.stdout) == (2, "")
        assert as_process.stderr == here(*given).stderr

    def test_a_directory_where_a_file_should_be(self, tmp_path: Path) -> None:
        self.refuse(here(*arguments(tmp_path, tmp_path / "out")), tmp_path / "out", "directory")

    def test_an_output_directory_that_cannot_be(self, measured: tuple, tmp_path: Path) -> None:
        (tmp_path / "taken").write_text("mine")
        done = here(*arguments(measured[0], tmp_path / "taken" / "out"))
        self.refuse(done, tmp_path / "taken" / "out", "taken")
        assert (tmp_path / "taken").read_text() == "mine"

    def test_an_unknown_table_tool(self, measured: tuple, tmp_path: Path) -> None:
        done = here(*arguments(measured[0], tmp_path / "out"), "--tool", "long")
        self.refuse(done, tmp_path / "out", "long", "probe")

    def test_earlier_results_survive_a_bad_run(self, rows: list[dict], tmp_path: Path) -> None:
        (tmp_path / "out").mkdir()
        (tmp_path / "out" / "table.csv").write_text("of last night")
        path = tmp_path / "balls.csv"
        path.write_text(edited(rows, 1, x_mm=""))
        done = here(*arguments(path, tmp_path / "out"))
        assert done.exit_code == 2
        assert [(p.name, p.read_text()) for p in (tmp_path / "out").iterdir()] == [("table.csv", "of last night")]


def test_side_file_and_report_have_the_checksum_of_the_table(measured: tuple) -> None:
    out = measured[3]
    crc32 = f"{zlib.crc32((out / 'table.csv').read_bytes()):08x}"
    assert json.loads((out / "table.json").read_text())["crc32"] == crc32
    assert crc32 in (out / "report.html").read_text()
