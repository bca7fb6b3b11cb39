"""`volcal study` from the command line: the same numbers on one core, two cores and a cluster; clear messages."""

from __future__ import annotations

import csv
import json
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import volcal_command
from click.testing import Result
from distributed import LocalCluster

CASE = ["--case", "case-study"]
VOLCAL = [sys.executable, "-m", "agent.cli.main", "study", *CASE]
MACHINES = Path(__file__).resolve().parents[2] / "config" / "machines"
SMALL = ["monte-carlo", "--machines", "5", "--stations", "2", "--set", "S3"]
RESULTS = ["monte-carlo.csv", "monte-carlo.json", "monte-carlo.png", "monte-carlo.svg"]


def volcal(*arguments: str | Path, **environment: str) -> subprocess.CompletedProcess[str]:
    command = [*VOLCAL, *map(str, arguments)]
    everything = {**os.environ, **environment}
    return subprocess.run(command, capture_output=True, text=True, timeout=600.0, check=False, env=everything)


def here(*arguments: str | Path) -> Result:
    """Run the same command in this process, which saves the start of a separate one."""
    return volcal_command.volcal("study", *CASE, *arguments, exit_code=None)


def refused(done: Result, code: int, *words: str) -> None:
    assert done.exit_code == code, done.stderr
    assert done.stdout == ""
    assert "Traceback" not in done.stderr
    message = " ".join(done.stderr.split())
    assert not isinstance(done.exception, Exception), done.exception
    assert all(word in message for word in words), done.stderr


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, subprocess.CompletedProcess[str]]:
    folder = tmp_path_factory.mktemp("alone")
    done = volcal(*SMALL, "--workers", "1", "--out", folder, "--json")
    assert done.returncode == 0, done.stderr
    return folder, done


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    with LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address="127.0.0.1:0") as running:
        yield running.scheduler_address


class TestSameNumbers:
    def test_on_more_cores(self, alone: tuple, tmp_path: Path) -> None:
        assert volcal(*SMALL, "--workers", "3", "--out", tmp_path).returncode == 0
        assert all((tmp_path / name).read_bytes() == (alone[0] / name).read_bytes() for name in RESULTS)

    def test_on_a_cluster(self, alone: tuple, address: str, tmp_path: Path) -> None:
        done = volcal(*SMALL, "--cluster", address, "--out", tmp_path)
        assert done.returncode == 0, done.stderr
        assert all((tmp_path / name).read_bytes() == (alone[0] / name).read_bytes() for name in RESULTS)

    def test_but_not_with_another_seed(self, alone: tuple, tmp_path: Path) -> None:
        assert here(*SMALL, "--workers", "1", "--seed", "2", "--out", tmp_path).exit_code == 0
        assert (tmp_path / "monte-carlo.csv").read_text() != (alone[0] / "monte-carlo.csv").read_text()


class TestWhatItSays:
    def test_stdout_is_one_json_object_and_progress_is_on_stderr(self, alone: tuple) -> None:
        folder, done = alone
        said = json.loads(done.stdout)
        assert done.stdout.count("\n") == 1
        assert (said["study"], said["machines"], said["seed"], said["set"]) == ("monte-carlo", 5, 1, "S3")
        assert {Path(path).name for path in said["files"].values()} == set(RESULTS)
        assert said["vce"]["aligned_um"] < said["ve"]["aligned_um"]
        assert "5/5" in done.stderr
        assert sorted(path.name for path in folder.iterdir()) == RESULTS

    def test_the_csv_has_a_row_for_each_machine(self, alone: tuple) -> None:
        rows = list(csv.DictReader((alone[0] / "monte-carlo.csv").read_text().splitlines()))
        assert [row["machine"] for row in rows] == ["0", "1", "2", "3", "4"]
        said = json.loads((alone[0] / "monte-carlo.json").read_text())
        squares = [float(row["vce_aligned_um"]) ** 2 for row in rows]
        assert (sum(squares) / 5) ** 0.5 == pytest.approx(said["vce"]["aligned_um"], rel=1e-6)

    def test_without_json_it_shows_a_table_and_the_files(self, tmp_path: Path) -> None:
        done = here(*SMALL, "--formulation", "distances", "--weights", "unit", "--out", tmp_path, "--workers", "1")
        assert done.exit_code == 0, done.stderr
        assert "vce closed form, aligned um" in done.stdout
        assert str(tmp_path / "monte-carlo.png") in done.stdout
        assert json.loads((tmp_path / "monte-carlo.json").read_text())["formulation"] == "distances"

    def test_the_published_method_is_one_of_its_studies(self, tmp_path: Path) -> None:
        done = here("trajectory", "--formulation", "published", "--stations", "2", "--out", tmp_path, "--json")
        assert done.exit_code == 0, done.stderr
        said = json.loads(done.stdout)
        assert (said["formulation"], said["prior"], said["weights"], said["cut_off"]) == (
            "published",
            False,
            "unit",
            0.01,
        )
        assert said["not_identified"] == []
        assert all(0.0 < left < 1.5 * said["rms_before_um"] for left in said["rms_left_um"].values())


class TestTruthRicherThanTheModel:
    def test_effects_and_other_true_machines_are_in_figures_and_facts(self, tmp_path: Path) -> None:
        truth = (MACHINES / "case-study.toml").read_text().replace("order = 5", "order = 6", 1)
        assert "order = 6" in truth
        other = tmp_path / "machines" / "true.toml"
        shutil.copytree(MACHINES, other.parent)
        other.write_text(truth)
        small = ["monte-carlo", "--machines", "2", "--stations", "2", "--set", "S3", "--workers", "1"]
        added: list[str | Path] = ["--with", "backlash=8um", "--with", "gradient=0.2K", "--true-machine", other]
        done = here(*small, *added, "--out", tmp_path / "with", "--json")
        assert done.exit_code == 0, done.stderr
        plain = here(*small, "--out", tmp_path / "plain", "--json")
        found, before = json.loads(done.stdout), json.loads(plain.stdout)
        assert found["with"] == ["backlash=8um", "gradient=0.2K"]
        assert "with" not in before
        assert found["vce_closed_form"]["aligned_um"] > before["vce_closed_form"]["aligned_um"] + 0.5
        assert "with backlash=8um, gradient=0.2K" in (tmp_path / "with" / "monte-carlo.svg").read_text()

    def test_effects_with_which_most_machines_are_refused_are_named(self, tmp_path: Path) -> None:
        small = ["monte-carlo", "--machines", "2", "--stations", "2", "--set", "S3", "--workers", "1"]
        done = here(*small, "--with", "drift=1000um", "--out", tmp_path)
        refused(done, 4, "of 2 simulated machines", "with drift=1000um", "state smaller effects")
        assert ".toml" not in done.stderr
        assert not list(tmp_path.iterdir())


class TestBadInput:
    @pytest.mark.parametrize(
        ("study", "stated", "words"),
        [
            ("monte-carlo", ["backlash"], ["'backlash' states no effect", "backlash=…um"]),
            ("monte-carlo", ["backlash=-1um"], ["states no effect"]),
            ("monte-carlo", ["backlash=5"], ["states no effect with its size and unit"]),
            ("monte-carlo", ["backlash=5K"], ["the size of 'backlash' is in µm, not in K", "write backlash=5um"]),
            ("monte-carlo", ["heat=2um"], ["the size of 'heat' is in K"]),
            ("monte-carlo", ["rust=2um"], ["there is no effect 'rust'"]),
            ("monte-carlo", ["heat=51K"], ["more than 50 K", "check the unit"]),
            ("monte-carlo", ["heat=1K", "heat=2K"], ["the effect 'heat' is stated twice"]),
            ("monte-carlo", ["heat=\u0663K"], ["states no effect"]),
            ("coverage", ["heat=2K"], ["the study 'coverage' does not take --with"]),
            ("volumetric-error", ["heat=2K"], ["does not take --with"]),
        ],
    )
    def test_an_effect_that_cannot_be(self, study: str, stated: list[str], words: list[str], tmp_path: Path) -> None:
        options = [part for one in stated for part in ("--with", one)]
        refused(here(study, *options, "--out", tmp_path), 2, *words)
        assert not list(tmp_path.iterdir())

    def test_true_machines_with_other_axes_or_of_other_studies(self, tmp_path: Path) -> None:
        mill = MACHINES / "mill.toml"
        refused(here(*SMALL, "--true-machine", mill, "--out", tmp_path), 2, "axis")
        refused(here("claims", "--true-machine", mill, "--out", tmp_path), 2, "'claims' does not take --true-machine")

    def test_an_unknown_study(self) -> None:
        refused(here("nonsense"), 2, "'nonsense' is not one of", "monte-carlo")

    @pytest.mark.parametrize("option", ["--machines", "--stations", "--workers"])
    def test_none_of_what_is_needed(self, option: str) -> None:
        refused(here("monte-carlo", option, "0"), 2, f"Invalid value for '{option}'", "x>=1")

    def test_a_machine_file_that_is_not_there(self, tmp_path: Path) -> None:
        missing = tmp_path / "none.toml"
        refused(here(*SMALL, "--machine", missing, "--out", tmp_path), 2, "there is no such file", str(missing))

    def test_a_machine_file_that_is_none(self, tmp_path: Path) -> None:
        (tmp_path / "machine.toml").write_text("chain = 3\n")
        done = here(*SMALL, "--machine", tmp_path / "machine.toml", "--out", tmp_path)
        refused(done, 2, "machine.toml", "chain")

    def test_a_set_that_is_unknown(self, tmp_path: Path) -> None:
        refused(here(*SMALL, "--set", "S9", "--out", tmp_path), 2, "unknown position set 'S9'", "S1, S2, S3")

    def test_a_set_that_identifies_nothing(self, tmp_path: Path) -> None:
        listed = tmp_path / "one.csv"
        listed.write_text("station,azimuth_deg,elevation_deg\n1,45,0\n")
        done = here(*SMALL, "--set", listed, "--out", tmp_path / "out", "--workers", "2")
        refused(done, 2, "cannot separate machine errors from artefact errors")
        assert not (tmp_path / "out").exists()

    def test_a_set_that_leaves_the_field_open_without_prior(self, tmp_path: Path) -> None:
        done = here(*SMALL, "--set", "S1", "--prior", "off", "--out", tmp_path, "--workers", "1")
        refused(done, 2, "of the error field open", "switch the prior on")

    def test_a_position_at_a_station_that_has_no_place(self, tmp_path: Path) -> None:
        listed = tmp_path / "far.csv"
        listed.write_text("station,azimuth_deg,elevation_deg\n1,45,0\n7,0,0\n")
        refused(here(*SMALL, "--set", listed, "--out", tmp_path), 2, "station 7 has no location")

    def test_a_folder_that_cannot_be_written(self, tmp_path: Path) -> None:
        (tmp_path / "taken").write_text("")
        refused(here(*SMALL, "--out", tmp_path / "taken"), 2, "this is a file, a directory is needed")

    def test_the_published_method_outside_its_studies_or_with_another_prior(self, tmp_path: Path) -> None:
        published: list[str | Path] = ["--formulation", "published", "--out", tmp_path]
        refused(here(*SMALL, *published), 2, "the publication has no study 'monte-carlo'", "ball-count", "strategy")
        refused(here("strategy", *published, "--prior", "on"), 2, "unit weights and no prior", "omit --prior")
        assert list(tmp_path.iterdir()) == []

    def test_both_kinds_of_workers(self, tmp_path: Path) -> None:
        both = ["--workers", "2", "--cluster", "tcp://127.0.0.1:8786"]
        refused(here(*SMALL, *both, "--out", tmp_path), 2, "--workers counts processes on this computer")

    def test_an_address_that_is_none(self, tmp_path: Path) -> None:
        refused(
            here(*SMALL, "--cluster", "there", "--out", tmp_path), 2, "'there' is not an address", "tcp://HOST:PORT"
        )

    def test_a_cluster_that_is_not_there(self, tmp_path: Path) -> None:
        refused(here(*SMALL, "--cluster", "tcp://127.0.0.1:9", "--out", tmp_path), 3, "no Dask scheduler answers")

    def test_a_cluster_without_its_package(self, tmp_path: Path) -> None:
        (tmp_path / "distributed.py").write_text("raise ModuleNotFoundError('gone', name='distributed')\n")
        out = tmp_path / "out"
        done = volcal(*SMALL, "--cluster", "tcp://127.0.0.1:9", "--out", out, PYTHONPATH=str(tmp_path))
        assert done.returncode == 2, done.stderr
        assert "a cluster needs the package 'distributed'" in done.stderr
        assert "pip install volcal[cluster]" in done.stderr


class TestInterrupt:
    def test_the_keyboard_ends_it_with_all_its_processes(self, tmp_path: Path) -> None:
        many = ["monte-carlo", "--machines", "100000", "--stations", "2", "--workers", "2"]
        command = [*VOLCAL, *many, "--out", str(tmp_path)]
        drawn = {**os.environ, "FORCE_COLOR": "1"}  # progress bar as on a terminal, which shows completed machines
        running = subprocess.Popen(command, stderr=subprocess.PIPE, process_group=0, env=drawn)
        assert running.stderr is not None
        try:
            read = b""
            while not re.search(rb"[1-9]\d*/100000", read):
                some = os.read(running.stderr.fileno(), 4096)
                assert some, read
                read += some
            os.killpg(running.pid, signal.SIGINT)
            said = running.communicate(timeout=600.0)[1].decode()  # end of file: no remaining process holds it open
        finally:
            if running.poll() is None:
                os.killpg(running.pid, signal.SIGKILL)
                running.communicate()
        assert running.returncode == 5, said
        assert "interrupted from the keyboard" in said
        assert "Traceback" not in said
        assert list(tmp_path.iterdir()) == []
