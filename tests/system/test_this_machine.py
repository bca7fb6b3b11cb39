"""Commands without a device answer for the machine of the directory, or by `--case` for a shipped one, and name it."""

from __future__ import annotations

import csv
import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import volcal_command
from hidden_machine import as_csv, hidden_machine, measured_rows
from volcal_command import volcal_json

from agent.planning.case_file import SHIPPED_CONFIGURATION, shipped_cases
from twin.artefact.position_set import parse_position_set

TRAVEL_MM = 2400.0
OTHER = "machine mill-7, artefact bar-of-mill-7"
COARSE = ("--grid", "4x3x3")
EMPTY = {
    "rank": ("rank",),
    "design": ("design", "--positions", "2"),
    "study": ("study", "volumetric-error"),
    "plan": ("plan",),
    "identify": ("identify", "balls.csv", "--out", "out"),
    "identify of one file": ("identify", "balls.csv", "--machine", "machine.toml", "--out", "out"),
}


volcal = partial(volcal_command.volcal, exit_code=None)


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def other_machine() -> None:
    """Write settings of a machine with half the travel along X and with other names into the current directory."""
    machine = (SHIPPED_CONFIGURATION / "machines" / "case-study.toml").read_text()
    deflection = SHIPPED_CONFIGURATION / "machines" / "case-study-deflection.csv"
    for former, now in (
        ('name = "case-study"', 'name = "mill-7"'),
        ("range_mm = [0.0, 4000.0]", f"range_mm = [0.0, {TRAVEL_MM}]"),
        ('"case-study-deflection.csv"', f'"{deflection}"'),
    ):
        assert former in machine
        machine = machine.replace(former, now)
    Path("machine.toml").write_text(machine)
    artefact = (SHIPPED_CONFIGURATION / "artefacts" / "ball-bar-1500.toml").read_text()
    Path("artefact.toml").write_text(artefact.replace('name = "ball-bar-1500"', 'name = "bar-of-mill-7"'))
    settings = (SHIPPED_CONFIGURATION / "case-study.toml").read_text()
    for former, now in (
        ("machines/case-study.toml", "machine.toml"),
        ("artefacts/ball-bar-1500.toml", "artefact.toml"),
        (", [2433.0, 1000.0, 750.0], [3300.0, 1000.0, 750.0]]", "]"),
        ("stations = [1, 4]", "stations = [1, 2]"),
        ("[timing]", "[table]\nstep_mm = [400.0, 260.0, 300.0]\n[timing]"),
    ):
        assert former in settings
        settings = settings.replace(former, now)
    Path("volcal.toml").write_text(settings)


@pytest.mark.parametrize("arguments", EMPTY.values(), ids=EMPTY)
def test_without_settings_a_command_says_what_to_do_and_writes_nothing(arguments: tuple[str, ...]) -> None:
    done = volcal(*arguments)
    assert (done.exit_code, done.stdout) == (2, "")
    [line] = done.stderr.splitlines()
    for words in ("this directory has no volcal.toml", "--config", "`volcal init`", "--case"):
        assert words in line
    assert list(Path().iterdir()) == []


def test_a_command_that_moves_the_machine_offers_no_shipped_case() -> None:
    done = volcal("calibrate")
    assert done.exit_code == 2
    assert "this directory has no volcal.toml" in done.stderr
    assert "--case" not in done.stderr


def test_a_case_that_is_not_shipped_and_two_machines_at_once_are_refused() -> None:
    done = volcal("rank", "--case", "lathe")
    assert done.exit_code == 2
    assert f"no case 'lathe' is shipped (key --case). shipped cases: {', '.join(shipped_cases())}" in done.stderr
    done = volcal("rank", "--case", "case-study", "--config", "volcal.toml")
    assert done.exit_code == 2
    assert "give one of the two" in done.stderr


def test_a_shipped_case_is_its_settings_file() -> None:
    settings = str(SHIPPED_CONFIGURATION / "case-study.toml")
    assert volcal_json("rank", "--case", "case-study", *COARSE) == volcal_json("rank", "--config", settings, *COARSE)
    assert all(case.settings.is_file() and case.scenario.is_file() for case in shipped_cases().values())
    assert {"case-study", "two-mounts"} <= set(shipped_cases())


@pytest.mark.usefixtures("other_machine")
class TestOtherMachine:
    def test_rank(self) -> None:
        found = volcal_json("rank", *COARSE)
        assert (found["machine"], found["artefact"]) == ("mill-7", "bar-of-mill-7")
        assert volcal("rank", *COARSE).stdout.startswith(f"{OTHER}\nS3 at 2 stations")
        assert volcal_json("rank", "--case", "case-study", *COARSE)["machine"] == "case-study"

    def test_design(self) -> None:
        done = volcal("design", "--positions", "2", "--grid-deg", "90", "--out", "set.csv")
        assert done.exit_code == 0, done.output
        assert done.stdout.startswith(f"{OTHER}\n")
        assert Path("set.csv").read_text().startswith(f"# {OTHER}\nstation,")
        [*_, row] = csv.DictReader(Path("set-front.csv").read_text().splitlines())
        assert (row["machine_name"], row["artefact_name"]) == ("mill-7", "bar-of-mill-7")
        assert OTHER in Path("set-front.svg").read_text()
        planned = json.loads(volcal("plan", "--position-set", "set.csv", "--json").stdout)  # exit code 7: gates
        assert (planned["machine"], planned["artefact"]) == ("mill-7", "bar-of-mill-7")

    def test_study(self) -> None:
        done = volcal("study", "volumetric-error", "--machines", "2", "--workers", "1")
        assert done.exit_code == 0, done.output
        assert done.stdout.startswith(f"{OTHER}\n")
        [*_, row] = csv.DictReader(Path("studies/volumetric-error.csv").read_text().splitlines())
        assert (row["machine_name"], row["artefact_name"]) == ("mill-7", "bar-of-mill-7")
        assert OTHER in Path("studies/volumetric-error.svg").read_text()
        assert json.loads(Path("studies/volumetric-error.json").read_text())["machine"] == "mill-7"

    def test_identify_takes_files_grid_and_identification_of_the_settings(self) -> None:
        """An option of the command line still wins over the settings."""
        settings = Path("volcal.toml")
        settings.write_text(settings.read_text() + '\n[identification]\norder = 2\nformulation = "distances"\n')
        rng = np.random.default_rng(3)
        rows = measured_rows(hidden_machine(rng), parse_position_set("S3", 4), rng)
        Path("balls.csv").write_text(as_csv([row for row in rows if float(row["x_mm"]) <= TRAVEL_MM]))
        found = volcal_json("identify", "balls.csv", "--out", "out", "--even-so", "--formulation", "centres")
        assert (found["machine"], found["artefact"], found["settings"]) == ("mill-7", "bar-of-mill-7", "volcal.toml")
        assert (found["formulation"], set(found["orders"].values())) == ("centres", {2})
        grid = json.loads(Path("out/table.json").read_text())["grid"]
        assert [len(grid[f"{axis}_mm"]) for axis in "xyz"] == [7, 6, 6]
        self.check_uses_of_the_table()

    @staticmethod
    def check_uses_of_the_table() -> None:
        """The table names its machine, and is used for no other one."""
        table = json.loads(Path("out/table.json").read_text())
        assert (table["machine"], table["artefact"]) == ("mill-7", "bar-of-mill-7")
        Path("part.nc").write_text("G21 G90\nG53 G0 X100 Y100 Z100\nG1 F500 X200\nM30\n")
        options = ("--max-chord-error", "20um", "--even-so", "--work-offset", "G54=0,0,0", "--out", "corrected.nc")
        correct = ("gcode", "correct", "part.nc", "--table", "out/table.csv", *options)
        export = ("table", "export", "--table", "out", "--format", "gcode-csv", "--out", "exported", "--even-so")
        for command in (correct, export):
            found = volcal_json(*command)
            assert (found["machine"], found["artefact"]) == ("mill-7", "bar-of-mill-7")
            refused = volcal(*command, "--case", "case-study")
            assert refused.exit_code == 2
            assert "corrects the machine mill-7, but the settings are those of the machine case-study" in refused.stderr
        done = volcal(*correct)
        assert (done.exit_code, done.stderr.splitlines()[0]) == (0, OTHER)
