"""Address of the database that stores the history of runs. The address is derived from the settings. The password is
read from a file and is never shown.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from sqlalchemy import URL, make_url
from sqlalchemy.exc import ArgumentError

from agent.files import read_text
from agent.history.run_row import machine_name
from agent.settings.history import HistorySettings
from agent.settings.schema import Settings
from drivers.errors import ConfigurationError

FILE_NAME = "history.sqlite"
POSTGRESQL = "postgresql"
_OTHERS = 0o077
_KEY = "history.url"


@dataclass(frozen=True)
class DatabaseAddress:
    """Address of the history database.

    `url` contains the password and must not be printed. `machine` is the name under which the runs of this machine are
    stored in the database.
    """

    url: URL
    machine: str
    timeout_s: float

    @property
    def text(self) -> str:
        """URL of the database without the password, for use in messages."""
        return self.url.render_as_string(hide_password=True)

    @property
    def is_file(self) -> bool:
        return self.url.get_backend_name() == "sqlite"


def database_address(settings: Settings) -> DatabaseAddress:
    """Return the address of the history database as given in `settings`. Raises what `address_of` raises."""
    return address_of(settings.history, machine_name(settings.model_dump(mode="json")), settings.state_directory)


def address_of(chosen: HistorySettings, machine: str, state_directory: Path) -> DatabaseAddress:
    """Return the address of the history database of a machine: that of the settings `chosen`, or else of a file in the
    state directory.

    Raises ConfigurationError if the URL is not supported or contains a password, or if the credentials file can be read
    by users other than the owner of the file.
    """
    if chosen.url is None:
        url = URL.create("sqlite", database=str(state_directory / FILE_NAME))
        return DatabaseAddress(url, machine, chosen.timeout_s)
    url = _parse_url(chosen.url)
    if chosen.credentials_file is not None:
        url = url.set(password=_password(chosen.credentials_file))
    return DatabaseAddress(url, machine, chosen.timeout_s)


def _parse_url(text: str) -> URL:
    try:
        url = make_url(text)
        backend = url.get_backend_name()
    except ArgumentError:
        hint = "write it as postgresql://USER@HOST:5432/DATABASE"
        raise ConfigurationError("not a valid database URL", key=_KEY, hint=hint) from None
    if backend == "sqlite":
        return url
    if backend != POSTGRESQL:
        hint = "use a SQLite file or PostgreSQL: postgresql://USER@HOST:5432/DATABASE"
        raise ConfigurationError(f"database {backend} is not supported for the history", key=_KEY, hint=hint)
    if url.password is not None or "password" in url.query:
        hint = "remove it from the settings and name a credentials file"
        raise ConfigurationError("the database URL contains a password", key=_KEY, hint=hint)
    return url.set(drivername=f"{POSTGRESQL}+psycopg")


def _password(path: Path) -> str:
    text = read_text(path, error=ConfigurationError).strip()
    if path.stat().st_mode & _OTHERS:
        raise ConfigurationError(
            "the credentials file can be read by others",
            key="history.credentials_file",
            file=str(path),
            hint="chmod 600",
        )
    if not text or "\n" in text:
        hint = "write the password on a single line"
        raise ConfigurationError("the credentials file contains no password", file=str(path), hint=hint)
    return text
