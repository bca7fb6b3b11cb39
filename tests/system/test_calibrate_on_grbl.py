"""`volcal calibrate` and `volcal simulate --serial` as two processes: a machine behind GRBL becomes better.

GRBL has no table. What is proved is the table that the driver's files say is active, against the same machine drawn
again in this process.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from drivers.serial_cnc.bank_files import BankFiles
from simulators.scenario import read_scenario
from simulators.world.world import World

CONFIG = Path(__file__).resolve().parents[2] / "config"
VOLCAL = [sys.executable, "-m", "agent.cli.main"]
LINK = "/tmp/volcal-grbl"  # noqa: S108  the name in the shipped file; it is replaced
END_WITHIN_S = 15.0


@dataclass
class Case:
    """A scenario, the simulator's ready line, settings for it."""

    scenario: Path
    ready: dict[str, Any]
    settings: Path

    def run(self, *words: str) -> subprocess.CompletedProcess[str]:
        command = [*VOLCAL, *words, "--config", str(self.settings)]
        return subprocess.run(
            command, cwd=self.settings.parent, capture_output=True, text=True, timeout=170.0, check=False
        )

    @property
    def banks(self) -> BankFiles:
        return BankFiles(self.settings.parent / "banks", {})


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Case]:
    directory = tmp_path_factory.mktemp("grbl")
    scenario = bad_machine(directory)
    link = directory / "ttyGRBL"
    options = ["--serial", str(link), "--can", "socketcand:127.0.0.1:0", "--end-with-stdin"]
    process = subprocess.Popen(
        [*VOLCAL, "simulate", "--config", str(scenario), *options], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    with process:
        try:
            ready = json.loads(process.stdout.readline())
            assert ready["serial"]["port"] == str(link)
            yield Case(scenario, ready, short_settings(directory, ready))
        finally:
            process.stdin.close()
            process.wait(END_WITHIN_S)
    assert not link.is_symlink()


def bad_machine(directory: Path) -> Path:
    """Four times the errors of the family: something that two positions can already better."""
    text = (CONFIG / "simulators" / "case-study.toml").read_text()
    text = text.replace('"../', f'"{CONFIG}/').replace("[truth]", "[truth]\nscale = 4.0")
    path = directory / "scenario.toml"
    path.write_text(text)
    return path


def short_settings(directory: Path, ready: dict[str, Any]) -> Path:
    """The shipped settings with three positions at one station, one of them held out, and the ports there are."""
    text = (CONFIG / "grbl.toml").read_text()
    (directory / "two.csv").write_text("station,azimuth_deg,elevation_deg\n1,45,0\n1,0,45\n")
    for former, now in (
        ('"machines/', f'"{CONFIG}/machines/'),
        ('"artefacts/', f'"{CONFIG}/artefacts/'),
        ('"../runs/grbl-banks"', '"banks"'),
        ('"../runs"', '"runs"'),
        (LINK, ready["serial"]["port"]),
        ("port = 5020", f"port = {ready['modbus']['port']}"),
        ("port = 29536", f"port = {ready['can']['options']['port']}"),
        ("port = 5022", f"port = {ready['control']['port']}"),
        ("port = 5021", f"port = {ready['time']['port']}"),
        ('position_set = "S3"', f'position_set = "{directory / "two.csv"}"\nstations = [1]'),
        ("[verification]\nstations = [1, 4]", "[verification]\nstations = [1]\npositions_deg = [[20.0, 25.0]]\n"
         "largest_share = 1.0\nlargest_chi2 = 1000.0"),
        ("[gates]", "[gates]\nsmallest_freedom = 1\nlargest_remaining_share = 1.0\nlargest_chi2 = 1000.0"),
    ):  # fmt: skip
        assert former in text, former
        text = text.replace(former, now)
    path = directory / "volcal.toml"
    path.write_text(text)
    return path


def test_the_zero_of_the_axes_is_the_one_shipped(case: Case) -> None:
    zero = re.search(r"axis_zero_mm = (\[.*?\])", case.settings.read_text())
    assert zero is not None
    assert case.ready["serial"]["axis_zero_mm"] == json.loads(zero[1])


def test_doctor_finds_nothing_wrong_and_says_where_the_tables_are(case: Case) -> None:
    ended = case.run("doctor")
    assert ended.returncode == 0, ended.stdout + ended.stderr
    said = " ".join(ended.stdout.split())
    assert "volcal gcode correct" in said
    assert "1.1h" in said


@pytest.mark.timeout(180)
def test_the_machine_becomes_better(case: Case) -> None:
    ended = case.run("calibrate", "--json")
    assert ended.returncode == 0, ended.stderr
    document = json.loads(ended.stdout)
    assert (document["state"], document["verified"], document["table_bank"]) == ("complete", True, 1)
    bank, _ = case.banks.active()
    table = case.banks.read(bank)
    assert bank == 1
    assert table is not None
    world = World(read_scenario(case.scenario))
    world.controller.write_bank(1, table)
    _, before_um = world.truth.true_volumetric_error()
    _, after_um = world.truth.true_volumetric_error(1)
    assert after_um < 0.9 * before_um
