"""`volcal table export` on the results of `volcal identify`: files, figures, and what it says to wrong input."""

from __future__ import annotations

import gzip
import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import volcal_command
from click.testing import Result
from hidden_machine import ARTEFACT_FILE, MACHINE_FILE, HiddenMachine, ball_file

from agent.cli.table_commands import table_export
from agent.results.table_image import image_of
from drivers.roles import Activation, StoreLimits
from twin.compensation.controllers.registry import FORMATS
from twin.compensation.table_file import parse_table
from twin.machine.volumetric import evaluation_grid, volumetric_error

POINTS = {"fanuc-3d": ["--points", "21x14x16"]}


volcal = partial(volcal_command.volcal, exit_code=None)


def export(run: Path, out: Path, name: str, *more: str | Path) -> Result:
    return volcal("table", "export", "--table", run, "--format", name, "--out", out, *POINTS.get(name, []), *more)


@pytest.fixture(scope="module")
def identified(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, HiddenMachine]:
    folder = tmp_path_factory.mktemp("identified")
    machine = ball_file(folder / "balls.csv", expression="S3", stations=4)
    files = ("--machine", MACHINE_FILE, "--artefact", ARTEFACT_FILE, "--out", folder / "run", "--order", "5")
    done = volcal("identify", folder / "balls.csv", *files, "--temperature-uncertainty", "0.1", "--no-report")
    assert done.exit_code == 0, done.output
    return folder / "run", machine


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_from_the_folder_of_a_run(name: str, identified: tuple, tmp_path: Path) -> None:
    run, _ = identified
    done = export(run, tmp_path / "out", name, "--json")
    assert done.exit_code == 0, done.output
    said = json.loads(done.stdout)
    assert said["ve_full_um"] < said["ve_reduced_um"] + 0.01
    assert said["ve_reduced_um"] < said["ve_before_um"]
    assert said["kept_percent"] <= 100.1
    assert said["unknown_um"] > 0.0
    assert said["lost"]
    assert max(map(abs, said["check_moves_um"])) > 2.0
    written = sorted(str(path) for path in (tmp_path / "out").iterdir())
    assert written == sorted([*said["files"], str(tmp_path / "out" / "export.json")])
    record = json.loads((tmp_path / "out" / "export.json").read_text())
    assert {key: record[key] for key in said} == said
    assert record["table_crc32"] == json.loads((run / "table.json").read_text())["crc32"]


def test_the_figures_are_shown(identified: tuple, tmp_path: Path) -> None:
    done = export(identified[0], tmp_path / "out", "heidenhain-com")
    assert done.exit_code == 0
    for text in (
        "before",
        "with the whole table",
        "as written",
        "lost: rotation",
        "CONFIG.CMA",
        "as estimated",
        "To check the sign",
    ):
        assert text in done.output
    assert "OPPOSITE" not in done.output


def test_what_part_programs_are_corrected_with_makes_the_hidden_machine_better(
    identified: tuple, tmp_path: Path
) -> None:
    run, machine = identified
    left = []
    for more in ([], ["--opposite-sign"]):
        out = tmp_path / str(len(more))
        assert export(run, out, "gcode-csv", *more).exit_code == 0
        table = parse_table((out / "table.csv").read_text(), (out / "table.json").read_text(), "table", "side")
        grid = evaluation_grid(machine.description.model.ranges_mm, (12, 8, 8))
        added = table.at(grid)
        inside = np.clip(grid + added, *np.array(machine.description.limits).T)  # the deflection is known there
        left.append(volumetric_error(grid + machine.offset, added + machine.deviation(inside)).aligned_um)
    bare = volumetric_error(grid + machine.offset, machine.deviation(grid)).aligned_um
    assert left[0] < 0.85 * bare
    assert left[1] > 1.2 * bare


def test_a_table_alone_speaks_for_itself(identified: tuple, tmp_path: Path) -> None:
    for name in ("table.csv", "table.json"):
        shutil.copy(identified[0] / name, tmp_path / name)
    done = export(tmp_path / "table.csv", tmp_path / "out", "siemens-cec", "--tables", "8", "--json")
    said = json.loads(done.stdout)
    assert said["estimate"] is None
    assert said["unknown_um"] is None
    assert said["facts"]["tables"] <= 8
    assert said["ve_full_um"] == 0.0


def test_the_folder_of_a_compacted_run(identified: tuple, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    shutil.copytree(identified[0], folder)
    estimate = folder / "estimate.json"
    (folder / "estimate.json.gz").write_bytes(gzip.compress(estimate.read_bytes()))
    estimate.unlink()
    whole = json.loads(export(identified[0], tmp_path / "whole", "isg-volcomp", "--json").stdout)
    said = json.loads(export(folder, tmp_path / "out", "isg-volcomp", "--json").stdout)
    assert said["unknown_um"] == whole["unknown_um"] is not None
    names = [Path(file).name for file in whole["files"]]
    assert names
    for name in names:
        assert (tmp_path / "out" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()


class TestWrongInput:
    def refused(self, done: Result, out: Path, *texts: str, code: int = 2) -> None:
        assert done.exit_code == code, done.output
        for text in texts:
            assert text in done.output
        assert "Traceback" not in done.output
        assert not out.exists()

    def test_too_many_points(self, identified: tuple, tmp_path: Path) -> None:
        out = tmp_path / "out"
        done = volcal("table", "export", "--table", identified[0], "--format", "fanuc-3d", "--out", out)
        self.refused(done, out, "41 points, but the lattice allows 25", "table.csv", "--points 21x14x16")

    def test_the_estimate_of_another_night(self, identified: tuple, tmp_path: Path) -> None:
        run, _ = identified
        text = json.loads((run / "estimate.json").read_text())
        text["parameters"][0]["value"] += 5e-3
        other = tmp_path / "other.json"
        other.write_text(json.dumps(text))
        done = export(run, tmp_path / "out", "siemens-lec", "--estimate", other)
        self.refused(done, tmp_path / "out", "not of the same machine, tool or night", "table.csv")

    def test_error_motions_of_a_table_alone(self, identified: tuple, tmp_path: Path) -> None:
        for name in ("table.csv", "table.json"):
            shutil.copy(identified[0] / name, tmp_path / name)
        done = export(tmp_path / "table.csv", tmp_path / "out", "isg-volcomp")
        self.refused(done, tmp_path / "out", "needs the estimate", "--estimate")

    def test_a_table_that_was_changed(self, identified: tuple, tmp_path: Path) -> None:
        for name in ("table.csv", "table.json"):
            shutil.copy(identified[0] / name, tmp_path / name)
        with (tmp_path / "table.csv").open("a") as file:
            file.write("\n")
        self.refused(export(tmp_path / "table.csv", tmp_path / "out", "neutral"), tmp_path / "out", "CRC-32")

    def test_corrections_beyond_what_is_allowed(self, identified: tuple, tmp_path: Path) -> None:
        done = export(identified[0], tmp_path / "out", "neutral", "--largest-um", "1")
        self.refused(done, tmp_path / "out", "is larger than 1 µm", "row", "table.csv")

    def test_no_such_run(self, tmp_path: Path) -> None:
        done = export(tmp_path / "nowhere", tmp_path / "out", "neutral")
        self.refused(done, tmp_path / "out", "there is no such file")

    @pytest.mark.parametrize(
        ("more", "text"),
        [
            (["--encoder", "1"], "--encoder is an option of the formats siemens-lec"),
            (["--no-products"], "--no-products is an option of the formats siemens-cec"),
            (["--reference-mm", "0,0,0"], "--reference-mm is an option of the formats linuxcnc-comp"),
            (["--axes", "A,B,C"], "--axes is an option of the formats"),
            (["--axes", "X,X,Z"], "three different names"),
            (["--points", "41"], "points along X, Y and Z"),
            (["--reference-mm", "0,0"], "three positions"),
            (["--bank", "1"], "give one of the two"),
            (["--magnification", "101"], "101 is not in the range"),
        ],
    )
    def test_options_that_do_not_fit(self, more: list[str], text: str, identified: tuple, tmp_path: Path) -> None:
        self.refused(export(identified[0], tmp_path / "out", "neutral", *more), tmp_path / "out", text)

    def test_options_of_a_format_without_one(self, identified: tuple, tmp_path: Path) -> None:
        out = tmp_path / "out.csv"
        done = volcal("table", "export", "--table", identified[0], "--out", out, "--opposite-sign")
        self.refused(done, out, "need --format")


def test_a_folder_is_written_whole_or_not_at_all(identified: tuple, tmp_path: Path) -> None:
    out = tmp_path / "out"
    (out / "points.csv").mkdir(parents=True)
    done = export(identified[0], out, "fanuc-3d")
    assert done.exit_code == 2
    assert [path.name for path in out.iterdir()] == ["points.csv"]


@pytest.mark.parametrize("name", [None, "siemens-lec"])
def test_a_bank_of_the_controller(
    name: str | None, identified: tuple, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, machine = identified
    table = parse_table((run / "table.csv").read_text(), (run / "table.json").read_text(), "table", "side")
    limits = StoreLimits((1, 2), (100, 100, 100), 10**6, 1e-3 if name else 1e-4, 1.0, Activation.IMMEDIATE)
    image = image_of(table, limits)
    store = SimpleNamespace(active_bank=lambda: 2, read_table=lambda bank: image if bank == 2 else None)

    @contextmanager
    def connected(_config: Path) -> Iterator[tuple[SimpleNamespace, SimpleNamespace]]:
        yield SimpleNamespace(machine=machine.description, tool_offset_mm=machine.offset), SimpleNamespace(store=store)

    monkeypatch.setattr(table_export, "connected", connected)
    if name is None:
        done = volcal("table", "export", "--case", "case-study", "--out", tmp_path / "bank.csv")
        assert done.exit_code == 0, done.output
        read = parse_table((tmp_path / "bank.csv").read_text(), (tmp_path / "bank.json").read_text(), "table", "side")
        assert np.abs(read.corrections - table.corrections).max() < 6e-5
        assert (read.machine, read.artefact) == ("case-study", "")
        return
    bank = ("table", "export", "--case", "case-study", "--format", name)
    done = volcal(*bank, "--estimate", run / "estimate.json", "--out", tmp_path / "o")
    assert done.exit_code == 0, done.output
    assert "bank 2" in done.output
    empty = volcal(*bank, "--bank", "1", "--out", tmp_path / "p")
    assert empty.exit_code == 2
    assert "bank 1 holds no table" in empty.output
