"""Import contracts of pyproject.toml: each holds for the tree, and breaks with one import that it forbids."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
LINT = "import sys; from importlinter.cli import lint_imports_command; sys.exit(lint_imports_command())"


@dataclass(frozen=True)
class Offence:
    """An `imported` module that `file` must not import, by contract `broken`."""

    broken: str
    file: str
    imported: str


OFFENCES = (
    Offence("floors", "twin/errors.py", "agent.files"),
    Offence("floors", "twin/errors.py", "gcode.setup"),
    Offence("floors", "simulators/scenario.py", "agent.files"),
    Offence("library", "volcal/__init__.py", "drivers.errors"),
    Offence("agent-rooms", "agent/settings/load.py", "agent.runs.session"),
    Offence("agent-rooms", "agent/unlisted_room.py", "json"),
    Offence("cli-rooms", "agent/cli/run_commands/demo.py", "agent.cli.table_commands.table"),
    Offence("twin-rooms", "twin/arrays.py", "twin.machine"),
    Offence("identification-checks", "twin/identification/checks/outliers.py", "twin.identification.estimate"),
    Offence("service-rooms", "agent/service/state/archive.py", "agent.service.owner"),
    Offence("endpoints", "agent/service/gateway/__init__.py", "agent.service.opcua"),
    Offence("mathematics", "gcode/setup.py", "socket"),
    Offence("mathematics", "twin/arrays.py", "time"),
    Offence("drivers", "drivers/modbus_cnc/__init__.py", "drivers.linuxcnc"),
    Offence("driver-vocabulary", "drivers/clock.py", "drivers.registry"),
    Offence("no-concrete-driver", "agent/execution/rig.py", "drivers.modbus_cnc"),
    Offence("physics", "simulators/world/world.py", "socket"),
    Offence("journal", "agent/runs/reconcile.py", "sqlite3"),
    Offence("history-database", "agent/reports/run_report.py", "sqlalchemy.orm"),
    Offence("figures", "agent/planning/preflight.py", "matplotlib.figure"),
    Offence("web", "agent/service/owner/owner.py", "fastapi"),
    Offence("web", "agent/service/owner/owner.py", "starlette.requests"),
    Offence("finite-elements", "agent/studies/study.py", "skfem.helpers"),
)


def settings() -> dict[str, Any]:
    document: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    return document


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the packages and their contracts."""
    copied = tmp_path_factory.mktemp("tree")
    for package in settings()["root_packages"]:
        shutil.copytree(ROOT / package, copied / package, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", copied)
    return copied


def lint(tree: Path, *options: str) -> subprocess.CompletedProcess[str]:
    """Run `lint-imports` on the tree; the environment's path to other copies of the packages is left out."""
    command = [sys.executable, "-c", LINT, "--no-cache", "--no-logo", *options]
    return subprocess.run(
        command, cwd=tree, env={"PATH": ""}, capture_output=True, text=True, timeout=600.0, check=False
    )


@contextmanager
def importing(path: Path, module: str) -> Iterator[None]:
    former = path.read_text() if path.exists() else None
    path.write_text(f"{former or ''}\nimport {module}\n")
    try:
        yield
    finally:
        if former is None:
            path.unlink()
        else:
            path.write_text(former)


def test_every_contract_is_broken_by_some_offence() -> None:
    identities = [contract["id"] for contract in settings()["contracts"]]
    assert len(identities) == len(set(identities))
    assert {offence.broken for offence in OFFENCES} == set(identities)


def test_all_contracts_hold(tree: Path) -> None:
    checked = lint(tree)
    assert checked.returncode == 0, checked.stdout + checked.stderr
    assert f"{len(settings()['contracts'])} kept, 0 broken" in checked.stdout


@pytest.mark.parametrize("offence", OFFENCES, ids=lambda offence: f"{offence.broken}-{offence.imported}")
def test_one_forbidden_import_breaks_the_contract(tree: Path, offence: Offence) -> None:
    with importing(tree / offence.file, offence.imported):
        checked = lint(tree, "--contract", offence.broken)
    assert checked.returncode == 1, checked.stdout + checked.stderr
    assert "0 kept, 1 broken" in checked.stdout, checked.stdout
