"""Access token of the service. A person or program with the token may move the machine and write tables.

The token is stored in a file that only the file's owner can read. The file is the one passed by systemd
(LoadCredential=token:…) or else the one named in the settings. If there is neither, the service creates the file in the
state directory, so that a first start needs no preparation.
"""

from __future__ import annotations

import os
import secrets
from collections.abc import Mapping
from pathlib import Path

from agent.settings.credentials import handed_over, open_mode
from agent.settings.schema import Settings
from drivers.errors import ConfigurationError
from drivers.foreign_errors import cause_of

FILE_NAME = "token"
MIN_LENGTH = 16


def token_path(settings: Settings, environment: Mapping[str, str] = os.environ) -> Path:
    """Return the path of the token file, which may not exist yet."""
    return handed_over(FILE_NAME, environment) or settings.service.token_file or settings.state_directory / FILE_NAME


def make_token(settings: Settings) -> None:
    """Create a token file in the state directory. Do nothing if the file exists already, or if systemd or the settings
    provide another token file."""
    path = token_path(settings)
    if settings.service.token_file is not None or path.exists():
        return
    try:
        handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(handle, "w", encoding="ascii") as file:
            file.write(f"{secrets.token_urlsafe(32)}\n")
    except OSError as error:
        raise ConfigurationError(
            f"the token cannot be written: {cause_of(error)}", key="state_directory", file=str(path)
        ) from error


def read_token(path: Path) -> str:
    """Return the token. Raise ConfigurationError if the token is missing or too short, or if users other than the owner
    of the file can access the file."""
    try:
        mode = open_mode(path)
        text = path.read_text(encoding="ascii").strip()
    except (OSError, UnicodeDecodeError) as error:
        reason = cause_of(error) if isinstance(error, OSError) else "it is not plain text"
        raise ConfigurationError(
            f"the token cannot be read: {reason}",
            key="service.token_file",
            hint="start the service once, or run this command as the user of the service",
            file=str(path),
        ) from error
    if mode is not None:
        raise ConfigurationError(
            f"the token file can be read by others (mode {mode:04o})",
            key="service.token_file",
            hint=f"chmod 600 {path}",
            file=str(path),
        )
    if len(text) < MIN_LENGTH:
        raise ConfigurationError(
            f"the token has {len(text)} characters, at least {MIN_LENGTH} are required",
            key="service.token_file",
            file=str(path),
        )
    return text
