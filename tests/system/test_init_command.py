"""`volcal init`: from an empty directory to an accepted simulated calibration, without a file edited by hand."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest
from simulated import COMMAND
from volcal_command import volcal

POSITIONS = "station,azimuth_deg,elevation_deg\n" + "".join(
    f"{station},{azimuth},{elevation}\n"
    for station in (1, 2)
    for azimuth, elevation in ((45, 0), (-45, 0), (0, 45), (0, -45), (90, 45), (90, -45))
)
MILL = ("--class", "mill", "--travel", "800", "500", "400")


def run(directory: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*COMMAND, *arguments], cwd=directory, capture_output=True, text=True, timeout=600.0, check=False,
        stdin=subprocess.DEVNULL,
    )  # fmt: skip


def test_a_vertical_mill_is_calibrated_in_simulation_with_two_commands(tmp_path: Path) -> None:
    (tmp_path / "short.csv").write_text(POSITIONS)
    made = run(
        tmp_path, "init", "mine", *MILL, "--stations", "2", "--position-set", "short.csv", "--touches", "5", "--json"
    )
    assert made.returncode == 0, made.stderr
    document = json.loads(made.stdout)
    assert document["positions"] == 12
    assert document["next"] == ["cd mine", "volcal calibrate --simulated"]
    assert all((tmp_path / path).is_file() for path in (*document["files"], *document["preview"]))
    ended = run(tmp_path / "mine", "calibrate", "--simulated", "--json")
    assert ended.returncode == 0, ended.stderr
    result = json.loads(ended.stdout)
    assert result["verified"] is True
    assert result["collisions"] == 0
    assert result["machine"] == "mine"
    assert result["true_ve_after_um"] < 0.6 * result["true_ve_before_um"]


def test_an_artefact_placed_by_hand_is_calibrated_in_simulation_with_two_commands(tmp_path: Path) -> None:
    made = run(
        tmp_path, "init", "mine", *MILL, "--placement", "by-hand", "--shape", "tetrahedron", "--touches", "5", "--json"
    )
    assert made.returncode == 0, made.stderr
    assert run(tmp_path / "mine", "config", "check").returncode == 0
    planned = run(tmp_path / "mine", "plan", "--preview", "picture")
    assert planned.returncode == 0, planned.stderr
    ended = run(tmp_path / "mine", "calibrate", "--simulated", "--json")
    assert ended.returncode == 0, ended.stderr
    result = json.loads(ended.stdout)
    assert (result["verified"], result["collisions"]) == (True, 0)
    assert result["true_ve_after_um"] < 0.6 * result["true_ve_before_um"]


def test_a_machine_with_grbl_is_simulated_over_its_serial_line(tmp_path: Path) -> None:
    (tmp_path / "short.csv").write_text(POSITIONS)
    router = ("--class", "router", "--travel", "600", "400", "200", "--controller", "serial-cnc", "--touches", "5")
    made = run(tmp_path, "init", "mine", *router, "--address", str(tmp_path / "absent"), "--stations", "2",
               "--position-set", "short.csv", "--json")  # fmt: skip
    assert made.returncode == 0, made.stderr
    settings = tmp_path / "mine" / "volcal.toml"
    settings.write_text(settings.read_text().replace("{ artefact = 20.0", "{ artefact = 27.0"))
    ended = run(tmp_path / "mine", "calibrate", "--simulated", "--json")
    assert ended.returncode == 0, ended.stderr
    result = json.loads(ended.stdout)
    assert result["verified"] is True
    assert result["collisions"] == 0
    # the correction is in part programs, not in the controller, so the simulator does not know the error after it
    assert result["true_ve_after_um"] is None
    assert "GRBL on /dev/" in ended.stderr
    assert "Modbus" not in ended.stderr
    assert not (tmp_path / "mine" / "banks").exists()
    assert (tmp_path / "mine" / "runs" / "simulated" / "banks").is_dir()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--travel", "800", "500", "400"), "--class is needed"),
        (("--class", "mill"), "--travel is needed"),
        (("--class", "mill", "--travel", "800", "500", "high"), "'high' is not a travel"),
        (("--class", "mill", "--travel", "800", "500", "4"), "not a travel between"),
        ((*MILL, "--chain", "tool-Z-bed-X-workpiece"), "axis Y is missing"),
        ((*MILL, "--controller", "serial-cnc"), "--address is needed"),
        ((*MILL, "--artefact", "nowhere.toml"), "nowhere.toml"),
        ((*MILL, "--shape", "ball-plate", "--balls", "15"), "has no 15 balls"),
        ((*MILL, "--size", "-400"), "'-400' is not a length"),
        ((*MILL, "--rapid", "20000", "0", "20000"), "'20000 0 20000' are not three values above 0"),
        ((*MILL, "--mount-at", "0", "0", "5000"), "no position has three balls"),
        (("--class", "mill", "--controller", "modbus-cnc", "--address", "127.0.0.1:1"), "--travel is needed"),
    ],
)
def test_what_is_missing_or_impossible_is_one_error_and_nothing_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], words: str
) -> None:
    monkeypatch.chdir(tmp_path)
    ended = volcal("init", "mine", *arguments, exit_code=2)
    complaint = [line for line in ended.stderr.splitlines() if not line.startswith("note: ")]
    assert len(complaint) == 1
    assert complaint[0].startswith("error: ")
    assert words in complaint[0]
    assert list(tmp_path.iterdir()) == []


def test_an_implausible_value_is_warned_of_and_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "short.csv").write_text(POSITIONS)
    ended = volcal(
        "init", "mine", *MILL, "--stations", "2", "--position-set", "short.csv", "--touches", "5",
        "--tip-diameter", "0.2", exit_code=None,
    )  # fmt: skip
    assert "warning: mine/volcal.toml, key probe.tip_radius_mm: the value 0.1 mm is not plausible" in ended.stderr
    assert "tip_radius_mm = 0.1 " in (tmp_path / "mine" / "volcal.toml").read_text()


def test_existing_settings_are_kept_without_force(tmp_path: Path) -> None:
    settings = tmp_path / "volcal.toml"
    settings.write_text("mine\n")
    ended = volcal("init", tmp_path, *MILL, exit_code=2)
    assert "add --force" in ended.stderr
    assert settings.read_text() == "mine\n"
