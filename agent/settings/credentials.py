"""Secrets in files: those that systemd hands over (LoadCredential=), and those that lie somewhere."""

from __future__ import annotations

import os
import stat
from collections.abc import Mapping
from pathlib import Path

DIRECTORY = "CREDENTIALS_DIRECTORY"


def handed_over(name: str, environment: Mapping[str, str] = os.environ) -> Path | None:
    """The credential of this name, where systemd has handed it over."""
    directory = environment.get(DIRECTORY)
    if directory and (Path(directory) / name).is_file():
        return Path(directory) / name
    return None


def open_mode(path: Path, environment: Mapping[str, str] = os.environ) -> int | None:
    """The file's mode where others than its owner may get at it, None where nobody may. Raises OSError.

    systemd keeps credentials in a directory for one service, and lets it in by an access control list: the group bits
    of such a file are the mask of that list (0440) and let no group in.
    """
    mode = stat.S_IMODE(path.stat().st_mode)
    directory = environment.get(DIRECTORY)
    mask = stat.S_IRGRP if directory and path.parent == Path(directory) else 0
    return mode if mode & 0o077 & ~mask else None
