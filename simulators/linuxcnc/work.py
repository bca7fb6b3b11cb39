"""Working directory of a LinuxCNC. It holds a copy of the configuration, and the original is never modified."""

from __future__ import annotations

import shutil
from pathlib import Path

from drivers.errors import ConfigurationError

EMPTY = ("machine.var",)
TABLES = "tables"


def prepare_work_directory(configuration: Path, components: Path, work: Path) -> None:
    """Copy the INI, HAL (hardware abstraction layer) and tool files of a LinuxCNC configuration and the HAL files of
    the components to `work`.

    A directory for compensation tables is created as well. The agent's settings are not copied.
    """
    if not configuration.is_dir():
        raise ConfigurationError("no such directory", file=str(configuration))
    work.mkdir(parents=True, exist_ok=True)
    work.chmod(0o777)  # parts of LinuxCNC run as another user
    for file in (*configuration.iterdir(), *components.glob("*.hal")):
        if file.is_file() and file.suffix != ".toml":
            shutil.copy(file, work)
    for name in EMPTY:
        (work / name).touch()
        (work / name).chmod(0o666)
    (work / TABLES).mkdir(exist_ok=True)
    (work / TABLES).chmod(0o777)
