"""`volcal identify` leaves no table that would make a foreign machine worse, and says what it does not know."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result
from foreign_case_files import Case, written_case
from volcal_command import volcal

from agent.cli.main import main
from agent.results.gates.gate_rules import GATE_RULES
from campaigns.foreign.artefact import S1, S3, STATIONS_MM

ESTIMATE_ONLY = ["artefact-covariance.csv", "artefact.toml", "estimate.json", "report.html"]
ALL = [*ESTIMATE_ONLY, "table.csv", "table.json"]
POOR: dict[str, dict[str, Any]] = {
    "S1 at one station": {"orientations": S1, "stations": STATIONS_MM[1:2]},
    "two positions": {"orientations": S3[:2], "stations": STATIONS_MM[1:2]},
    "noise stated three times too small": {"orientations": S3, "stated_noise": 0.33},
}


def identify(case: Case, out: Path, *options: str) -> Result:
    """Run the real command. The thermometer is stated: with the 1 K that is assumed without it, a good set may fail."""
    stated = ("--temperature-uncertainty", "0.1")
    return volcal("identify", *case.arguments, "--out", out, *stated, *options, exit_code=None)


def files(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.fixture(scope="module", params=POOR)
def poor(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Case:
    return written_case(tmp_path_factory.mktemp("poor"), 1, **POOR[request.param])


@pytest.fixture(scope="module")
def weak(tmp_path_factory: pytest.TempPathFactory) -> Case:
    return written_case(tmp_path_factory.mktemp("weak"), 1, **POOR["S1 at one station"])


@pytest.fixture(scope="module")
def weak_table(weak: Case) -> Path:
    """Folder of a table that was written although a gate had not been passed."""
    done = identify(weak, weak.folder / "even-so", "--even-so")
    assert done.exit_code == 0, done.output
    return weak.folder / "even-so"


def test_a_measurement_that_says_too_little_leaves_no_table(poor: Case, tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = identify(poor, out, "--json")
    assert done.exit_code == 4, done.output
    document, message = json.loads(done.stdout), done.stderr
    failed = [name for name, passed in document["gates"].items() if not passed]
    assert failed
    titles = [GATE_RULES[name].title for name in failed]
    assert message.startswith("error: no table was written: ")
    assert all(f"{title}: " in message for title in titles)
    assert "--even-so" in message
    assert (document["state"], document["table"]) == ("refused", None)
    assert all(f"{title}: " in document["reason"] for title in titles)
    assert files(out) == ESTIMATE_ONLY
    page = (out / "report.html").read_text()
    assert all(f"No table was written: the gate {name} failed" in page for name in failed)


def test_the_table_of_an_earlier_night_does_not_stay_beside_a_refused_estimate(weak: Case, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    for name in ("table.csv", "table.json", "notes.txt"):
        (out / name).write_text("of last night")
    assert identify(weak, out).exit_code == 4
    assert files(out) == sorted([*ESTIMATE_ONLY, "notes.txt"])


def test_consent_writes_the_table_with_a_mark(weak_table: Path) -> None:
    assert files(weak_table) == ALL
    assert "gain" in json.loads((weak_table / "table.json").read_text())["gates_not_passed"]
    assert "Written although the gate gain failed: " in (weak_table / "report.html").read_text()


def test_a_marked_table_goes_nowhere_without_the_same_consent(weak_table: Path, tmp_path: Path) -> None:
    part = tmp_path / "part.nc"
    part.write_text("G21 G90 G17\nG0 X10 Y10 Z10\nG1 X100 F500\nM30\n")
    table = str(weak_table / "table.csv")
    uses = (
        ["table", "export", "--table", str(weak_table), "--out", str(tmp_path / "neutral.csv")],
        ["table", "export", "--table", table, "--format", "gcode-csv", "--out", str(tmp_path / "csv")],
        ["gcode", "correct", str(part), "--table", table, "--max-chord-error", "2um", "-o", str(tmp_path / "out.nc"),
         "--work-offset", "G54=0,0,0", "--start", "0,0,0"],
    )  # fmt: skip
    for use in uses:
        done = CliRunner().invoke(main, use)
        assert done.exit_code == 4, done.output
        assert "did not pass the gates gain, unmeasured" in done.stderr
        assert "--even-so" in done.stderr
        allowed = CliRunner().invoke(main, [*use, "--even-so"])
        assert "did not pass the gates gain, unmeasured" not in allowed.stderr
    assert json.loads((tmp_path / "neutral.json").read_text())["gates_not_passed"] == ["gain", "unmeasured"]


@pytest.mark.parametrize("seed", range(3))
def test_a_good_set_passes_and_makes_the_machine_better_as_stated(seed: int, tmp_path: Path) -> None:
    case = written_case(tmp_path, seed, S3)
    done = identify(case, tmp_path / "out", "--json")
    assert done.exit_code == 0, done.output
    document = json.loads(done.stdout)
    assert files(tmp_path / "out") == ALL
    assert "gates_not_passed" not in json.loads((tmp_path / "out" / "table.json").read_text())
    assert (document["state"], document["reason"]) == ("complete", "")
    assert case.true_vce_um(tmp_path / "out" / "table.csv") < 0.5 * case.true_ve_um
    low, high = document["estimated_ve_limits_um"]
    assert low < document["estimated_ve_um"] < high
    assert 0.9 * low < case.true_ve_um < 1.1 * high
    low, high = document["predicted_vce_limits_um"]
    assert low < document["predicted_vce_um"] < high
    assert 0.8 * low < case.true_vce_um(tmp_path / "out" / "table.csv") < 1.2 * high


def test_the_limits_stand_in_every_result(tmp_path: Path) -> None:
    case = written_case(tmp_path, 0, S3)
    document = json.loads(identify(case, tmp_path / "out", "--json").stdout)
    stored = json.loads((tmp_path / "out" / "estimate.json").read_text())
    names = ("estimated_ve_um", "estimated_ve_limits_um", "predicted_vce_um", "predicted_vce_limits_um")
    assert stored["volumetric"] == {name: document[name] for name in names}
    page, shown = (
        (tmp_path / "out" / "report.html").read_text(),
        identify(case, tmp_path / "again", "--no-report").stdout,
    )
    for name in ("estimated_ve", "predicted_vce"):
        low, high = document[f"{name}_limits_um"]
        decimals = 1 if document[f"{name}_um"] >= 10.0 else 2
        limits = f"95 % limits {low:.{decimals}f} to {high:.{decimals}f} µm"
        assert f"{document[f'{name}_um']:.{decimals}f} µm, {limits}" in page
        assert f"{low:.2f} to {high:.2f} µm" in shown


def test_nothing_is_stated_about_the_rigid_motion_that_no_artefact_sees(tmp_path: Path) -> None:
    case = written_case(tmp_path, 0, S3)
    done = identify(case, tmp_path / "out")
    page = (tmp_path / "out" / "report.html").read_text()
    for text in (done.stdout, page):
        assert "as defined" not in text
        assert "not aligned" not in text
    document = json.loads(identify(case, tmp_path / "json", "--json", "--no-report").stdout)
    assert document["predicted_vce_raw_um"] is None
