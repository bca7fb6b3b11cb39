"""`volcal demo` over its real links: a short set at one station, what is proved let through."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest
from simulated import SHORT_SET, scenario_text

ROOT = Path(__file__).resolve().parents[2]
CONFIG = ROOT / "config"
KEYS = {
    "state", "run_id", "position_set", "formulation", "balls", "touches", "machine_minutes", "wall_seconds", "rank",
    "parameters", "predicted_vce_um", "verified", "table_bank", "report",
    "true_ve_before_um", "true_ve_after_um", "collisions",
}  # fmt: skip


def short_settings(directory: Path, shipped: str = "case-study.toml", more: Sequence[tuple[str, str]] = ()) -> Path:
    """The shipped settings with three positions at one station and one held out; `more` is replaced besides."""
    text = (CONFIG / shipped).read_text()
    (directory / "short.csv").write_text(SHORT_SET)
    for former, now in (
        ('"machines/', f'"{CONFIG}/machines/'),
        ('"artefacts/', f'"{CONFIG}/artefacts/'),
        ('position_set = "S3"', f'position_set = "{directory / "short.csv"}"\nstations = [1]'),
        ("[verification]\nstations = [1, 4]", "[verification]\nstations = [1]\npositions_deg = [[20.0, 25.0]]\n"
         "max_chi2 = 1000.0"),
        ("[timing]", "[gates]\nmin_degrees_of_freedom = 1\n"
         "max_unmeasured_fraction = 10.0\nmax_chi2 = 1000.0\n\n[timing]"),
        *more,
    ):  # fmt: skip
        assert former in text, former
        text = text.replace(former, now)
    path = directory / "volcal.toml"
    path.write_text(text)
    return path


def bad_machine(directory: Path) -> Path:
    """Four times the errors of the family: something that three positions can already better."""
    path = directory / "scenario.toml"
    path.write_text(scenario_text().replace("[truth]", "[truth]\nscale = 4.0"))
    return path


def demo(directory: Path, *options: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "agent.cli.main", "demo", "--config", str(short_settings(directory))]
    return subprocess.run(
        [*command, "--scenario", str(bad_machine(directory)), "--out", str(directory / "out"), *options],
        cwd=directory,
        capture_output=True,
        text=True,
        timeout=600.0,
        check=False,
    )


def test_demo_ends_with_one_json_object(tmp_path: Path) -> None:
    ended = demo(tmp_path, "--json", "--cross-check")
    assert ended.returncode == 0, ended.stderr
    lines = ended.stdout.splitlines()
    assert len(lines) == 1
    document = json.loads(lines[0])
    assert set(document) >= KEYS
    assert document["state"] == "complete"
    assert document["verified"] is True
    assert document["collisions"] == 0
    assert document["table_bank"] == 1
    assert document["balls"] == 33
    assert document["true_ve_after_um"] < document["true_ve_before_um"]
    before, after = document["figures"]
    assert (before["figure"], after["figure"]) == ("ve_before", "vce_after")
    assert (before["true_um"], after["true_um"]) == (document["true_ve_before_um"], document["true_ve_after_um"])
    assert (before["stated_um"], after["stated_um"]) == (document["estimated_ve_um"], document["predicted_vce_um"])
    for figure in (before, after):
        low, high = figure["limits_um"]
        assert figure["inside"] == (low <= figure["true_um"] <= high)
        assert 0.9 * low < figure["true_um"] < 1.1 * high
    assert Path(document["report"]).is_file()
    compared = document["cross_check"]["figures"]
    assert [figure["with_table"] for figure in compared[:38]] == [False] * 19 + [True] * 19
    repeated = [f"{name} {axis}" for axis in "XYZ" for name in ("A", "E", "R", "B")]
    assert [figure["figure"] for figure in compared[38:]] == 2 * repeated
    assert document["cross_check"]["agreeing"] == sum(abs(figure["en"]) <= 1.0 for figure in compared)
    assert Path(document["report"]).with_name("cross-check.svg").is_file()
    assert "min left" in ended.stderr.replace("of machine time ", "")
    assert "127.0.0.1" in ended.stderr


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--can", "carrier-pigeon:3"), "carrier-pigeon"),
        (("--scenario", "nowhere.toml"), "nowhere.toml"),
        (("--config", "nowhere.toml"), "nowhere.toml"),
    ],
)
def test_demo_that_cannot_start_says_why(tmp_path: Path, options: tuple[str, ...], words: str) -> None:
    ended = demo(tmp_path, *options)
    assert ended.returncode in (2, 3)
    assert ended.stdout == ""
    [complaint] = ended.stderr.strip().splitlines()
    assert complaint.startswith("error: ")
    assert words in complaint
