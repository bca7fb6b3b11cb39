"""The wheel, installed outside the checkout: it holds every file that the program reads, and its commands work."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Sequence
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("agent", "drivers", "gcode", "simulators", "twin", "volcal")
SOURCES = (*PACKAGES, "config", "pyproject.toml", "README.md", "LICENSE")
COMMAND = "import sys; from agent.cli.main import main; sys.argv[0] = 'volcal'; main()"
POSITIONS = "station,azimuth_deg,elevation_deg\n1,45,0\n1,0,45\n"


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, built from a copy without the leftovers of earlier builds."""
    source, wheels = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("wheels")
    for name in SOURCES:
        if (ROOT / name).is_dir():
            ignored = shutil.ignore_patterns("__pycache__")
            shutil.copytree(ROOT / name, source / name, symlinks=True, ignore=ignored)
        else:
            shutil.copy(ROOT / name, source / name)
    program = "import sys; from setuptools.build_meta import build_wheel; build_wheel(sys.argv[1])"
    _run([sys.executable, "-c", program, str(wheels)], source)
    (built,) = wheels.glob("volcal-*.whl")
    return built


@pytest.fixture(scope="module")
def site(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory with the contents of the wheel; the dependencies are those of this interpreter."""
    target = tmp_path_factory.mktemp("site")
    options = ("--quiet", "--disable-pip-version-check", "--no-deps", "--no-index", "--no-compile")
    _run([sys.executable, "-m", "pip", "install", *options, "--target", str(target), str(wheel)], target)
    return target


def test_the_wheel_holds_every_file_of_the_packages(wheel: Path) -> None:
    expected = {
        path.relative_to(ROOT).as_posix()
        for package in PACKAGES
        for path in (ROOT / package).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    expected |= {
        f"volcal/{path.relative_to(ROOT).as_posix()}" for path in (ROOT / "config").rglob("*") if path.is_file()
    }
    held = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    assert held == expected


def test_the_shipped_configuration_is_read_from_the_installed_package(site: Path, tmp_path: Path) -> None:
    program = "from agent.planning.case_file import CASE_STUDY; import agent, twin, volcal; print(CASE_STUDY)"
    printed = _run([sys.executable, "-c", program], tmp_path, site).strip()
    assert printed == str(site / "volcal" / "config" / "case-study.toml")


def test_demo_runs_from_an_empty_directory(site: Path, tmp_path: Path) -> None:
    """With few positions the case study's gates refuse the table (exit code 4), after the whole run has been made."""
    (tmp_path / "few.csv").write_text(POSITIONS)
    done = _volcal(site, tmp_path, "demo", "--position-set", "few.csv")
    assert done.returncode in (0, 4), done.stderr
    (report,) = (tmp_path / "runs").glob("*/report.html")
    assert "volcal" in report.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "arguments",
    [
        ("rank", "--case", "case-study"),
        ("design", "--case", "case-study", "--positions", "3", "--grid-deg", "45", "--stations", "1"),
        ("study", "volumetric-error", "--case", "case-study", "--out", "study"),
        ("simulate", "--help"),
    ],
    ids=lambda arguments: arguments[0],
)
def test_commands_run_from_an_empty_directory(site: Path, tmp_path: Path, arguments: Sequence[str]) -> None:
    done = _volcal(site, tmp_path, *arguments)
    assert done.returncode == 0, done.stderr
    assert done.stdout


def _volcal(site: Path, directory: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", COMMAND, *arguments]
    return subprocess.run(command, cwd=directory, env=_environment(site), capture_output=True, text=True, check=False)


def _run(command: Sequence[str], directory: Path, site: Path | None = None) -> str:
    done = subprocess.run(command, cwd=directory, env=_environment(site), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def _environment(site: Path | None) -> dict[str, str]:
    """This environment; `site` is searched before anything else, an editable installation included."""
    inherited = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    return inherited if site is None else {**inherited, "PYTHONPATH": str(site)}
