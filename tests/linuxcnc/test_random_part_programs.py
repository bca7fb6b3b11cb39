"""Random part programs with codes of many modal groups in one block, corrected and compared with the original by
LinuxCNC's own interpreter: a small sample of `python -m campaigns.part_programs`.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from requirements import skip_if_missing

from campaigns.part_programs.__main__ import main, summarise
from campaigns.part_programs.comparison import CHORD_MM, ProgramTrial, compare, try_program
from campaigns.part_programs.rs274 import RS274, Executed, execute

pytestmark = skip_if_missing("" if RS274 else "its interpreter rs274 is not installed")

SAMPLE = 60


def test_a_sample_of_random_programs(tmp_path: Path) -> None:
    trials = [try_program(seed, tmp_path) for seed in range(SAMPLE)]
    result = summarise(trials)
    assert result["failures"] == []
    assert result["moves"] > 4 * SAMPLE
    assert max(trial.deviation_mm for trial in trials) < CHORD_MM


def executed(program: str, folder: Path) -> Executed:
    path = folder / "part.ngc"
    path.write_text(program)
    return execute(path, folder)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ("N10 G21 G0 X10 Y0 Z0\nN20 G1 X20.5 F100\nM2\n", "µm from the path"),
        ("N10 G21 G0 X10 Y0 Z0\nN20 G0 X20\nM2\n", "moves are rapid and not feed"),
        ("N10 G21 G0 X10 Y0 Z0\nN20 G1 X20 F200\nM2\n", "the moves take"),
        ("N10 G21 G0 X10 Y0 Z0\nN20 M8 G1 X20 F100\nM2\n", "the state is"),
    ],
)
def test_the_comparison_finds_what_is_wrong(
    wrong: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("campaigns.part_programs.comparison._FIELD", lambda points: 0.0 * points)
    right = "N10 G21 G0 X10 Y0 Z0\nN20 G1 X20 F100\nM2\n"
    original = executed(right, tmp_path)
    trial = ProgramTrial(0, program=right)
    compare(original, executed(right, tmp_path), trial)
    assert not trial.failures
    compare(original, executed(wrong, tmp_path), trial)
    assert said in trial.failures[0]
    assert "N20 G1" in trial.failures[0]


def test_one_program_is_printed_with_its_result(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--only", "1"]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith("N10 G21")
    assert json.loads(printed.splitlines()[-1])["programs"] == 1
