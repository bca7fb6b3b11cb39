"""Tests of a third-party driver in a package of its own: it is installed, found, configured, diagnosed and contract-
tested. Apart from the example itself, nothing in this repository knows its name."""

from __future__ import annotations

import importlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest
from aloud import NOT_HERE

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "tests" / "plugin_example"


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Directory into which the example is installed, without a package index or a download."""
    if int(version("setuptools").split(".")[0]) < 77:
        pytest.skip(f"{NOT_HERE}: the example plugin, built and installed: setuptools 77 or later is missing")
    folder = tmp_path_factory.mktemp("third-party")
    source = shutil.copytree(EXAMPLE, folder / "source")
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-index"]
    command += ["--no-deps", "--no-build-isolation", "--target", str(folder / "site"), str(source)]
    subprocess.run(command, check=True, timeout=600.0, capture_output=True)
    return folder / "site"


def run(installed: Path, *words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", *words],
        env={**os.environ, "PYTHONPATH": str(installed)},
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=600.0,
        check=False,
    )


@pytest.fixture
def controller(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Simulated controller from the example's own tests."""
    monkeypatch.syspath_prepend(str(EXAMPLE / "tests"))
    with closing(importlib.import_module("acme_controller").AcmeController()) as controller:
        yield controller


@pytest.fixture
def settings(tmp_path: Path, controller: Any) -> Path:
    """Shipped settings with the roles machine and probe assigned to the plugin; the tables are unchanged."""
    text = (ROOT / "config" / "case-study.toml").read_text(encoding="utf-8")
    plugin = (
        f'[devices.acme]\ndriver = "acme-cnc"\n[devices.acme.options]\nhost = "127.0.0.1"\nport = {controller.port}\n'
    )
    for former, now in (
        ('"machines/', f'"{ROOT}/config/machines/'),
        ('"artefacts/', f'"{ROOT}/config/artefacts/'),
        ("[devices.mount]", f"{plugin}\n[devices.mount]"),
        ('machine = "cnc"\nprobe = "cnc"', 'machine = "acme"\nprobe = "acme"'),
    ):
        assert former in text, former
        text = text.replace(former, now)
    path = tmp_path / "volcal.toml"
    path.write_text(text[: text.index("[clock]")] + text[text.index("[devices.cnc]") :], encoding="utf-8")
    return path


def test_it_is_found_configured_and_diagnosed(installed: Path, settings: Path, tmp_path: Path) -> None:
    completed = run(installed, "agent.cli.main", "doctor", "--config", str(settings), "--json", cwd=tmp_path)
    assert "Traceback" not in completed.stderr
    lines = {line["subject"]: line for line in json.loads(completed.stdout)["acme"]}
    # the example's controller has another travel than the machine of the shipped settings, and is slower
    differing = {subject for subject, line in lines.items() if not line["ok"]}
    assert differing == {"travel X", "rapid X", "rapid Y", "rapid Z"}, lines
    assert lines["link"]["text"].startswith("acme 127.0.0.1:")
    assert lines["permissions"]["text"] == "0 missing"


def test_a_wrong_option_is_reported_with_its_key(installed: Path, settings: Path, tmp_path: Path) -> None:
    settings.write_text(
        settings.read_text(encoding="utf-8").replace("[devices.acme.options]\n", "[devices.acme.options]\nprot = 1\n"),
        encoding="utf-8",
    )
    completed = run(installed, "agent.cli.main", "doctor", "--config", str(settings), cwd=tmp_path)
    output = " ".join((completed.stdout + completed.stderr).split())
    assert completed.returncode == 2
    assert "devices.acme.options.prot" in output
    assert "options of driver acme-cnc: host, port, timeout_s" in output


def test_without_the_package_the_driver_is_unknown(settings: Path, tmp_path: Path) -> None:
    completed = run(tmp_path / "nothing", "agent.cli.main", "doctor", "--config", str(settings), cwd=tmp_path)
    assert completed.returncode == 2
    assert "unknown driver 'acme-cnc'" in " ".join((completed.stdout + completed.stderr).split())


def test_it_fulfils_the_contract(installed: Path, tmp_path: Path) -> None:
    tests = shutil.copytree(EXAMPLE / "tests", tmp_path / "tests")
    completed = run(installed, "pytest", "-q", "-p", "no:cacheprovider", str(tests), cwd=tmp_path)
    assert completed.returncode == 0, completed.stdout[-3000:]
    assert "17 passed" in completed.stdout
