"""The directory in which a LinuxCNC runs: its configuration, copied, so that nothing is written where that is kept."""

from __future__ import annotations

import shutil
from pathlib import Path

from drivers.errors import ConfigurationError

EMPTY = ("machine.var",)
TABLES = "tables"


def prepare_work_directory(configuration: Path, components: Path, work: Path) -> None:
    """Copy INI, HAL and tool files and the HAL files of the components (not the agent's settings); make the tables'
    directory."""
    if not configuration.is_dir():
        raise ConfigurationError("no such directory", file=str(configuration))
    work.mkdir(parents=True, exist_ok=True)
    work.chmod(0o777)  # parts of LinuxCNC run under another user
    for file in (*configuration.iterdir(), *components.glob("*.hal")):
        if file.is_file() and file.suffix != ".toml":
            shutil.copy(file, work)
    for name in EMPTY:
        (work / name).touch()
        (work / name).chmod(0o666)
    (work / TABLES).mkdir(exist_ok=True)
    (work / TABLES).chmod(0o777)
