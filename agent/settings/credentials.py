"""Secrets in files. The functions find credentials passed by systemd (LoadCredential=) and check the access permissions
of files with secrets."""

from __future__ import annotations

import os
import stat
from collections.abc import Mapping
from pathlib import Path

DIRECTORY = "CREDENTIALS_DIRECTORY"


def handed_over(name: str, environment: Mapping[str, str] = os.environ) -> Path | None:
    """Return the path of the credential `name` if systemd has passed this credential to the service; otherwise return
    None."""
    directory = environment.get(DIRECTORY)
    if directory and (Path(directory) / name).is_file():
        return Path(directory) / name
    return None


def open_mode(path: Path, environment: Mapping[str, str] = os.environ) -> int | None:
    """Return the permission bits of the file if users other than its owner can access it; otherwise return None. Raises
    OSError if the file cannot be examined.

    systemd stores credentials in a directory per service and grants access to them with an access control list. The
    group bits of such a file (0440) are the mask of this list; they do not let any group read the file.
    """
    mode = stat.S_IMODE(path.stat().st_mode)
    directory = environment.get(DIRECTORY)
    mask = stat.S_IRGRP if directory and path.parent == Path(directory) else 0
    return mode if mode & 0o077 & ~mask else None
