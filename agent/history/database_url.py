"""Which database history is in, out of the settings; its password comes from a file and goes nowhere else."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from sqlalchemy import URL, make_url
from sqlalchemy.exc import ArgumentError

from agent.files import read_text
from agent.history.run_row import machine_name
from agent.settings.schema import Settings
from drivers.errors import ConfigurationError

FILE_NAME = "history.sqlite"
POSTGRESQL = "postgresql"
_OTHERS = 0o077
_KEY = "history.url"


@dataclass(frozen=True)
class DatabaseAddress:
    """`url` with the password in it: never printed as it stands. `machine`: the name of this one in history."""

    url: URL
    machine: str
    timeout_s: float

    @property
    def text(self) -> str:
        """For people: no password."""
        return self.url.render_as_string(hide_password=True)

    @property
    def is_file(self) -> bool:
        return self.url.get_backend_name() == "sqlite"


def database_address(settings: Settings) -> DatabaseAddress:
    """Raises ConfigurationError for a URL of another kind, one with a password in it, or an unsafe credentials file."""
    chosen, machine = settings.history, machine_name(settings.model_dump(mode="json"))
    if chosen.url is None:
        url = URL.create("sqlite", database=str(settings.state_directory / FILE_NAME))
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
        raise ConfigurationError("this is no database URL", key=_KEY, hint=hint) from None
    if backend == "sqlite":
        return url
    if backend != POSTGRESQL:
        hint = "a SQLite file or PostgreSQL: postgresql://USER@HOST:5432/DATABASE"
        raise ConfigurationError(f"history cannot be kept in {backend}", key=_KEY, hint=hint)
    if url.password is not None or "password" in url.query:
        hint = "take it out of the settings and name a credentials file"
        raise ConfigurationError("the database URL holds a password", key=_KEY, hint=hint)
    return url.set(drivername=f"{POSTGRESQL}+psycopg")


def _password(path: Path) -> str:
    text = read_text(path, error=ConfigurationError).strip()
    if path.stat().st_mode & _OTHERS:
        raise ConfigurationError(
            "others can read the credentials file", key="history.credentials_file", file=str(path), hint="chmod 600"
        )
    if not text or "\n" in text:
        hint = "put the password alone on one line"
        raise ConfigurationError("the credentials file holds no password", file=str(path), hint=hint)
    return text
