"""`volcal gcode correct` as a process: parts on the simulated machine, what is refused, what is left behind."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hidden_machine import ARTEFACT_FILE, MACHINE_FILE, HiddenMachine, ball_file
from scipy.interpolate import RegularGridInterpolator
from volcal_command import volcal

sys.path.insert(0, str(Path(__file__).parents[1] / "property"))

from plain_gcode import PlainController, dense, far, path

CHORD_MM = 0.002
WORK = (1500.0, 500.0, 600.0)
TOOL = (0.0, 0.0, 80.0)
HOME = (3900.0, 1200.0, 1400.0)

PART = """%
(a frame, a bore, a helix and a contour)
N10 G21 G90 G17 G94
N20 G91 G28 Z0
N30 T1 M6 (end mill)
N40 G90 G54 G0 X-1200 Y-350 S8000 M3
N50 G43 H1 Z60
N60 G1 Z-300 F400 M8
N70 X1900 F1200
N80 Y500
N90 X-1200 Z200
N100 G3 X-1100 Y400 I100 J0
N110 G1 Y-350
N120 G0 Z150
N130 X400 Y-100
N140 G2 X400 Y-100 Z-150 I250 J0 P3 F800
N150 G18 G3 X900 Z-150 R250
N160 G20 G1 X10.5 Y-4.25 F30
N170 G21 G91 X50 Y50
N180 G90 G93 X800 Y300 F0.5
N190 G94 G0 Z200 M9
N200 G53 G0 Z1400 M5
N210 M30
%
"""


@pytest.fixture(scope="module")
def identified(tmp_path_factory: pytest.TempPathFactory) -> tuple[HiddenMachine, Path]:
    """A machine with orders up to 7 and a deflection, and the table of the model of lower order found for it."""
    folder = tmp_path_factory.mktemp("identified")
    machine = ball_file(folder / "balls.csv", seed=3)
    where = ("--machine", MACHINE_FILE, "--artefact", ARTEFACT_FILE, "--out", folder)
    volcal("identify", folder / "balls.csv", *where, "--temperature-uncertainty", "0.1", "--no-report")
    return machine, folder / "table.csv"


def given(table: Path) -> list[str | Path]:
    triples = {"--work-offset": f"G54={WORK}", "--tool": f"1={TOOL}", "--reference": f"G28={HOME}"}
    said = [part for name, text in triples.items() for part in (name, text.replace("(", "").replace(")", ""))]
    return ["--table", table, "--max-chord-error", "2um", *said]


def test_as_a_process(identified: tuple, tmp_path: Path) -> None:
    (tmp_path / "part.nc").write_text(PART)
    (tmp_path / "bad.nc").write_text(PART.replace("N80 Y500", "N80 G42 Y500"))
    for part, code in (("part.nc", 0), ("bad.nc", 2)):
        command = [sys.executable, "-m", "agent.cli.main", "gcode", "correct", str(tmp_path / part)]
        done = subprocess.run(
            [*command, *map(str, given(identified[1]))], capture_output=True, timeout=600.0, check=False
        )
        assert (done.returncode, bool(done.stdout)) == (code, code == 0), done.stderr
        assert (b"line 10" in done.stderr, b"Traceback" in done.stderr) == (code == 2, False)


def executed(text: str) -> np.ndarray:
    """Axis positions (n, 3) that cut, from the first one with F on."""
    plain = PlainController(np.array(HOME), work={"G54": WORK}, tools={1: TOOL}, references={28: HOME}, arc_step=0.002)
    return path(plain.run(text), feed_only=True)


class TestOnTheMachine:
    def test_a_corrected_part_lies_within_the_residual_of_the_table(self, identified: tuple, tmp_path: Path) -> None:
        """Every point of the cut, on the machine as it is, against where the program means it to be."""
        machine, table = identified
        part, out = tmp_path / "part.nc", tmp_path / "out.nc"
        part.write_text(PART)
        said = json.loads(volcal("gcode", "correct", part, *given(table), "-o", out, "--json").stdout)
        meant = dense(executed(PART), 5.0)
        residual = residual_field(machine, table, meant)
        cut = dense(executed(out.read_text()), 5.0)
        reached = cut + machine.deviation(cut)
        without = meant + machine.deviation(meant)
        assert far(reached, meant + residual) < CHORD_MM + 2e-4
        assert far(meant + residual, reached) < CHORD_MM + 2e-4
        assert far(reached, meant) < float(np.linalg.norm(residual, axis=1).max()) + CHORD_MM
        back = rigid(meant + residual, meant)
        before = far(rigid(without, meant)(without), meant)
        left = far(back(reached), meant)
        assert left < float(np.linalg.norm(back(meant + residual) - meant, axis=1).max()) + CHORD_MM
        assert left < 0.5 * before
        assert said["largest_correction_um"] > 10.0
        assert said["arcs"] == 3
        assert said["not_corrected"] == 1

    def test_the_other_sign_would_make_it_worse(self, identified: tuple, tmp_path: Path) -> None:
        machine, table = identified
        part, out = tmp_path / "part.nc", tmp_path / "out.nc"
        part.write_text(PART)
        volcal("gcode", "correct", part, *given(table), "-o", out)
        meant = executed(PART)
        cut = executed(out.read_text())[[0, -1]]
        ends = meant[[0, -1]]
        wrong = 2.0 * ends - cut
        for place, point in enumerate(ends):
            right = np.linalg.norm(cut[place] + machine.deviation(cut[place : place + 1])[0] - point)
            worse = np.linalg.norm(wrong[place] + machine.deviation(wrong[place : place + 1])[0] - point)
            assert right < worse

    def test_words_that_do_not_move_survive(self, identified: tuple, tmp_path: Path) -> None:
        table = identified[1]
        part = tmp_path / "part.nc"
        part.write_text(PART)
        done = volcal("gcode", "correct", part, *given(table))
        text = done.stdout
        assert "(a frame, a bore, a helix and a contour)" in text
        assert "N30 T1 M6 (end mill)" in text.splitlines()
        for words in ("S8000 M3", "M8", "M9", "M30"):
            assert words in text
        plain, corrected = (PlainController(np.array(HOME), {"G54": WORK}, {1: TOOL}, {28: HOME}) for _ in range(2))
        plain.run(PART)
        corrected.run(text)
        assert plain.others == corrected.others
        assert "moves corrected, by up to" in done.stderr


def rigid(points: np.ndarray, wanted: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """The rigid motion that brings `points` nearest to `wanted`: a part may lie anyhow, its form counts."""
    middle, aim = points.mean(axis=0), wanted.mean(axis=0)
    u, _, vt = np.linalg.svd((points - middle).T @ (wanted - aim))
    return lambda others: (others - middle) @ (u @ vt) + aim


def residual_field(machine: HiddenMachine, table: Path, points: np.ndarray) -> np.ndarray:
    """Return the error (n, 3) that the table leaves at axis positions (n, 3)."""
    rows = np.loadtxt(table, delimiter=",", skiprows=1)
    nodes = [np.unique(rows[:, axis]) for axis in range(3)]
    values = 1e-3 * rows[:, 3:].reshape(*map(len, nodes), 3)
    corrected = points + RegularGridInterpolator(nodes, values)(points)
    return corrected + machine.deviation(corrected) - points


class TestRefusals:
    @pytest.mark.parametrize(
        ("text", "words"),
        [
            ("G90 G0 X0 Y0 Z0\nG41 D1 X10\n", ["line 2", "G41", "cutter compensation"]),
            ("G90 G0 X0 Y0 Z0\nG1 X[#1+2] F100\n", ["line 2", "--parameter 1=VALUE"]),
            ("G90 G55 G0 X0 Y0 Z0\n", ["line 1", "G55", "--work-offset"]),
            ("G90 G0 X0 Y0 Z0\nG1 X9000 F100\n", ["line 2", "10500", "--outside clamp"]),
            ("G1 X0 F100\n", ["line 1", "--start"]),
            ("G90 G0 X0 Y0 Z0\nG43 H7 Z1\n", ["line 2", "--tool 7="]),
        ],
    )
    def test_line_and_reason_and_nothing_written(
        self, text: str, words: list[str], identified: tuple, tmp_path: Path
    ) -> None:
        part, out = tmp_path / "part.nc", tmp_path / "out.nc"
        part.write_text(text)
        out.write_text("what was there")
        done = volcal("gcode", "correct", part, *given(identified[1]), "-o", out, exit_code=None)
        assert done.exit_code == 2
        assert done.stderr.startswith("error: ")
        assert "Traceback" not in done.stderr
        for word in [*words, "part.nc"]:
            assert word in done.stderr
        assert out.read_text() == "what was there"
        assert sorted(found.name for found in tmp_path.iterdir()) == ["out.nc", "part.nc"]

    def test_nothing_goes_to_standard_output_before_all_is_corrected(self, identified: tuple, tmp_path: Path) -> None:
        part = tmp_path / "part.nc"
        part.write_text("G90 G0 X0 Y0 Z0\n" + "G1 X1 F100\n" * 20_000 + "G41 X2\n")
        done = volcal("gcode", "correct", part, *given(identified[1]), exit_code=None)
        assert (done.exit_code, done.stdout) == (2, "")
        assert "line 20002" in done.stderr

    def test_a_corrected_program_is_not_corrected_again(self, identified: tuple, tmp_path: Path) -> None:
        part, out = tmp_path / "part.nc", tmp_path / "out.nc"
        part.write_text(PART)
        volcal("gcode", "correct", part, *given(identified[1]), "-o", out)
        done = volcal("gcode", "correct", out, *given(identified[1]), "-o", tmp_path / "twice.nc", exit_code=None)
        assert (done.exit_code, (tmp_path / "twice.nc").exists()) == (2, False)
        assert "already corrected" in done.stderr
        same = volcal("gcode", "correct", part, *given(identified[1]), "-o", part, exit_code=None)
        assert (same.exit_code, part.read_text()) == (2, PART)

    @pytest.mark.parametrize(
        ("more", "word"),
        [
            (["--max-chord-error", "2"], "2um or 0.002mm"),
            (["--max-chord-error", "0.05um"], "more decimals"),
            (["--work-offset", "G60=1,2,3"], "G54"),
            (["--tool", "1=1,2"], "X,Y,Z"),
            (["--setup", "nothing.toml"], "no such file"),
            (["--json"], "--out"),
        ],
    )
    def test_wrong_options(self, more: list[str], word: str, identified: tuple, tmp_path: Path) -> None:
        part = tmp_path / "part.nc"
        part.write_text(PART)
        done = volcal("gcode", "correct", part, *given(identified[1]), *more, exit_code=None)
        assert (done.exit_code, done.stdout) == (2, "")
        assert word in done.stderr


def test_the_setup_file_says_what_options_say(identified: tuple, tmp_path: Path) -> None:
    part, setup = tmp_path / "part.nc", tmp_path / "setup.toml"
    part.write_bytes(PART.replace("end mill", "Fräser").replace("\n", "\r\n").encode("latin-1"))
    sections = {"work_offsets_mm": ("G54", WORK), "tools_mm": (1, TOOL), "reference_points_mm": ("G28", HOME)}
    setup.write_text("".join(f"[{name}]\n{key} = {list(value)}\n" for name, (key, value) in sections.items()))
    volcal("gcode", "correct", part, *given(identified[1]), "-o", tmp_path / "one.nc")
    by_file = ("--table", identified[1], "--max-chord-error", "0.002mm", "--setup", setup)
    volcal("gcode", "correct", part, *by_file, "-o", tmp_path / "two.nc")
    text = (tmp_path / "one.nc").read_bytes()
    assert text == (tmp_path / "two.nc").read_bytes()
    assert b"(Fr\xe4ser)" in text
    assert text.count(b"\r\n") == text.count(b"\n")


def test_a_wrong_setup_file_is_named_with_its_key(identified: tuple, tmp_path: Path) -> None:
    part, setup = tmp_path / "part.nc", tmp_path / "setup.toml"
    part.write_text(PART)
    setup.write_text("[tools_mm]\none = [0, 0, 1]\n")
    done = volcal("gcode", "correct", part, *given(identified[1]), "--setup", setup, exit_code=None)
    assert done.exit_code == 2
    assert "setup.toml" in done.stderr
    assert "tools_mm" in done.stderr
