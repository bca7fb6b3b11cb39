"""Commands in the directory of a simulated machine: its settings are found, and a simulator that is not running is
named."""

from __future__ import annotations

import re
from pathlib import Path

import click
import pytest
from click.testing import CliRunner
from volcal_command import volcal

from agent.cli.errors import reported
from agent.cli.options import config_option
from agent.execution.device_assembly import make_clock
from agent.settings.load import read_settings
from agent.settings.schema import ClockSettings
from agent.settings.simulator_command import command_of_settings, simulate_command

CONFIG = Path(__file__).resolve().parents[3] / "config"
NOWHERE = "port = 1\n"
"""A port at which nothing listens."""


@pytest.fixture
def directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The shipped case study as the directory of a machine whose simulator is not running."""
    text = (CONFIG / "case-study.toml").read_text()
    text = text.replace('"machines/', f'"{CONFIG}/machines/').replace('"artefacts/', f'"{CONFIG}/artefacts/')
    text = re.sub(r"port = \d+\n", NOWHERE, text).replace('"../runs"', '"runs"')
    (tmp_path / "volcal.toml").write_text(text)
    (tmp_path / "simulator.toml").write_text("")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_config_check_takes_the_settings_of_the_directory(directory: Path) -> None:
    assert "volcal.toml: good" in volcal("config", "check").stdout


def test_config_check_says_what_to_do_without_settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    refused = volcal("config", "check", exit_code=2).stderr
    assert "this directory has no volcal.toml" in refused
    assert "volcal init" in refused


@pytest.mark.parametrize(
    "words", [("table", "show"), ("doctor",), ("try",), ("calibrate",), ("verify",), ("nightly",)], ids=" ".join
)
def test_a_simulator_that_is_not_running_is_named(directory: Path, words: tuple[str, ...]) -> None:
    last = volcal(*words, exit_code=2).stderr.splitlines()[-1]
    assert "the simulated machine of this directory is not running" in last
    assert "`volcal simulate --config simulator.toml --modbus 127.0.0.1:1 " in last
    assert "refused" not in last
    assert "kind = 'real'" not in last


def test_a_settings_file_elsewhere_is_not_this_directory(
    directory: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path_factory.mktemp("elsewhere"))
    last = volcal("doctor", "--config", directory / "volcal.toml", exit_code=2).stderr.splitlines()[-1]
    assert "the simulated machine of these settings is not running" in last
    assert f"--config {directory}/simulator.toml" in last


def test_the_simulator_of_an_earlier_run_is_not_to_be_started(directory: Path) -> None:
    """A resumed run uses the settings with which it started, here those of a simulator of its own."""

    @click.command()
    @config_option
    @reported
    def resume(config: Path) -> None:
        del config
        make_clock(ClockSettings(kind="lockstep", host="127.0.0.1", port=2))

    refused = CliRunner().invoke(resume, [])
    assert refused.exit_code == 2
    assert "the simulated machine of this run has ended" in refused.stderr


@pytest.mark.parametrize("case", ["case-study", "mill", "hand-placed", "router", "bridge"])
def test_the_command_is_the_one_in_the_shipped_settings(case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(CONFIG.parent)
    file = Path("config") / f"{case}.toml"
    comment = file.read_text().split("[clock]")[0]
    shipped = re.search(r"volcal simulate --config.*\\\n.*", comment)
    assert shipped is not None
    words = shipped[0].replace("\\\n#", "").split()
    assert (command_of_settings(read_settings(file), file) or "").split() == words


def test_a_serial_line_is_in_the_command(tmp_path: Path) -> None:
    settings = tmp_path / "volcal.toml"
    settings.write_text((CONFIG / "grbl.toml").read_text())
    (tmp_path / "simulator.toml").write_text("")
    assert command_of_settings(read_settings(settings), settings) == simulate_command(
        f"{tmp_path}/simulator.toml",
        modbus="127.0.0.1:5020",
        serial="/tmp/volcal-grbl",  # noqa: S108  the name in the shipped file
        can="socketcand:127.0.0.1:29536",
        control="127.0.0.1:5022",
        time="127.0.0.1:5021",
    )
