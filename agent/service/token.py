"""The token: who has it may have the machine moved and tables written.

It lies in a file that nobody but its owner can read: the one that systemd hands over (LoadCredential=token:…), the one
that the settings name, or, so that a first start needs nothing, one that the service makes in the state directory.
"""

from __future__ import annotations

import os
import secrets
from collections.abc import Mapping
from pathlib import Path

from agent.settings.credentials import handed_over, open_mode
from agent.settings.schema import Settings
from drivers.errors import ConfigurationError

FILE_NAME = "token"
SHORTEST = 16


def token_path(settings: Settings, environment: Mapping[str, str] = os.environ) -> Path:
    """Where the token is, or would be."""
    return handed_over(FILE_NAME, environment) or settings.service.token_file or settings.state_directory / FILE_NAME


def make_token(settings: Settings) -> None:
    """In the state directory, where neither systemd nor the settings name one and there is none yet."""
    path = token_path(settings)
    if settings.service.token_file is not None or path.exists():
        return
    try:
        handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(handle, "w", encoding="ascii") as file:
            file.write(f"{secrets.token_urlsafe(32)}\n")
    except OSError as error:
        raise ConfigurationError(
            f"the token cannot be written: {error.strerror or error}", key="state_directory", file=str(path)
        ) from error


def read_token(path: Path) -> str:
    """ConfigurationError where it is missing, too short, or open to others than its owner."""
    try:
        mode = open_mode(path)
        text = path.read_text(encoding="ascii").strip()
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is no plain text"
        raise ConfigurationError(
            f"the token cannot be read: {reason}",
            key="service.token_file",
            hint="start the service once, or run this as the user that the service runs as",
            file=str(path),
        ) from error
    if mode is not None:
        raise ConfigurationError(
            f"the token's file is open to others (mode {mode:04o})",
            key="service.token_file",
            hint=f"chmod 600 {path}",
            file=str(path),
        )
    if len(text) < SHORTEST:
        raise ConfigurationError(
            f"the token has {len(text)} characters, {SHORTEST} are the least", key="service.token_file", file=str(path)
        )
    return text
