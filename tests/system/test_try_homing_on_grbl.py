"""`volcal try --homing` over the simulator's real links: a router on a pseudo-terminal that speaks GRBL, and one on
Modbus, which has no command for it."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from volcal_command import volcal, volcal_json

from agent.execution.journal_reader import open_journal

CONFIG = Path(__file__).resolve().parents[2] / "config"
VOLCAL = [sys.executable, "-m", "agent.cli.main"]
SIGMA_UM = (60.0, 20.0, 40.0)
END_WITHIN_S = 600.0
GRBL = """driver = "serial-cnc"
[devices.cnc.options]
port = "{port}"
axis_zero_mm = {axis_zero_mm}
declared_temperatures_c = {{ artefact = 20.5 }}
[devices.cnc.options.banks]
directory = "banks"
"""


@contextmanager
def router(directory: Path) -> Iterator[dict[str, Any]]:
    """Start the shipped router with a zero that scatters from homing to homing; yield the ready line."""
    text = (CONFIG / "simulators" / "router.toml").read_text(encoding="utf-8").replace('"../', f'"{CONFIG}/')
    assert "[axes]\n" in text
    scenario = directory / "simulator.toml"
    scenario.write_text(text.replace("[axes]\n", f"[axes]\nhoming_um = {list(SIGMA_UM)}\n"), encoding="utf-8")
    links = ["--serial", str(directory / "ttyGRBL"), "--can", "socketcand:127.0.0.1:0", "--end-with-stdin"]
    command = [*VOLCAL, "simulate", "--config", str(scenario), *links]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            yield json.loads(process.stdout.readline())
        finally:
            process.stdin.close()
            process.wait(END_WITHIN_S)


def settings(directory: Path, ready: dict[str, Any], name: str, cnc: str) -> Path:
    """Settings of the shipped router with the addresses of the simulator and the driver `cnc` of the controller."""
    text = (CONFIG / "router.toml").read_text(encoding="utf-8")
    head, _, rest = text.partition('driver = "modbus-cnc"')
    text = head + cnc + rest[rest.index("[devices.mount]") :]
    for shipped, own in (
        ("port = 5021", f"port = {ready['time']['port']}"),
        ("port = 29536", f"port = {ready['can']['options']['port']}"),
        ("port = 5022", f"port = {ready['control']['port']}"),
        ('"../runs"', f'"{name}-runs"'),
        ('"machines/', f'"{CONFIG}/machines/'),
        ('"artefacts/', f'"{CONFIG}/artefacts/'),
        ('"router-positions.csv"', f'"{CONFIG}/router-positions.csv"'),
    ):
        assert shipped in text, shipped
        text = text.replace(shipped, own)
    path = directory / f"{name}.toml"
    path.write_text(text, encoding="utf-8")
    return path


def called(config: Path, *words: str) -> subprocess.CompletedProcess[str]:
    command = [*VOLCAL, *words, "--config", str(config)]
    return subprocess.run(command, cwd=config.parent, capture_output=True, text=True, timeout=END_WITHIN_S, check=False)


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, dict[str, Any]]]:
    directory = tmp_path_factory.mktemp("router")
    with router(directory) as ready:
        yield directory, ready


def test_grbl_homes_and_the_plan_counts_what_was_measured(machine: tuple[Path, dict[str, Any]]) -> None:
    directory, ready = machine
    config = settings(directory, ready, "grbl", GRBL.format(**ready["serial"]))
    before = volcal_json("plan", "--config", config)
    assert before["after_homing"] is None
    assert "not known; volcal try --homing 5 measures the scatter" in volcal("plan", "--config", config).stdout
    tried = called(config, "try", "--homing", "4", "--json")
    assert tried.returncode == 0, tried.stderr
    homing = json.loads(tried.stdout)["trial"]["homing"]
    assert homing["homings"] == 4
    for sigma, (low, high), true in zip(homing["sigma_um"], homing["limits_um"], SIGMA_UM, strict=True):
        assert low <= true <= high
        assert low < sigma < high
    planned = volcal_json("plan", "--config", config)
    after = planned["after_homing"]
    assert after["sigma_um"] == homing["sigma_um"]
    assert after["ve_without_um"] == planned["predicted_vce_um"] == before["predicted_vce_um"]
    assert after["ve_um"] > after["ve_without_um"]
    text = f"work offsets kept over it: {after['offset_um']:.1f} µm rms more"
    assert text in volcal("plan", "--config", config).stdout


def test_modbus_refuses_in_plain_words_before_anything_moves(machine: tuple[Path, dict[str, Any]]) -> None:
    directory, ready = machine
    modbus = f'driver = "modbus-cnc"\n[devices.cnc.options]\nhost = "127.0.0.1"\nport = {ready["modbus"]["port"]}\n'
    config = settings(directory, ready, "modbus", modbus)
    ended = called(config, "try", "--homing", "3")
    assert ended.returncode not in (0, 1)
    assert "the Modbus register map has no command that homes the axes" in ended.stderr
    assert "nothing was moved" in ended.stderr
    with open_journal(directory / "modbus-runs") as reader:
        run = reader.last_run()
        assert run is not None
        assert (run.state, reader.steps(run.run)) == ("refused", ())


@pytest.mark.parametrize("count", ["2", "31", "x"])
def test_too_few_or_too_many_homings_are_refused(machine: tuple[Path, dict[str, Any]], count: str) -> None:
    directory, ready = machine
    config = settings(directory, ready, "count", GRBL.format(**ready["serial"]))
    assert "--homing" in volcal("try", "--homing", count, "--config", config, exit_code=2).stderr
