"""Creation of the database tables of the journal, which records all runs, and check of their version."""

from __future__ import annotations

import sqlite3
from importlib.resources import files
from pathlib import Path

from drivers.errors import ConfigurationError, VolcalError

FILE_NAME = "journal.sqlite"

VERSION = 4
"""Version of a journal with compacted runs, in `PRAGMA user_version`. Earlier programs refuse such a journal."""
WHOLE_VERSION = 3
"""Version of a journal in which every run is stored as it was written."""


def prepare(connection: sqlite3.Connection, path: Path) -> None:
    """Create the tables and indexes that the database does not have yet, in one transaction.

    These are all of them, or what an earlier program did not have yet: the indexes, and the table of compacted runs.
    After a power cut, the journal has all tables or none. Raises ConfigurationError if it has a different version; such
    a journal is not written to.
    """
    require_version(connection, path, ConfigurationError)
    connection.execute("PRAGMA journal_mode=WAL")
    connection.execute("PRAGMA synchronous=FULL")
    statements = (files(__package__) / "journal_schema.sql").read_text().split(";\n")
    connection.execute("BEGIN IMMEDIATE")
    try:
        for statement in statements:
            connection.execute(statement)
        if is_empty(connection):
            connection.execute(f"PRAGMA user_version = {WHOLE_VERSION}")
    except BaseException:
        connection.execute("ROLLBACK")
        raise
    connection.execute("COMMIT")


def require_version(connection: sqlite3.Connection, path: Path, failure: type[VolcalError]) -> None:
    """Raise an error of the class `failure` if the journal at `path` was written by a different version of volcal."""
    found = _version(connection)
    if found not in (0, WHOLE_VERSION, VERSION):  # an empty database has version 0
        raise failure(
            f"the journal has version {found}, and this version of volcal reads and writes the versions "
            f"{WHOLE_VERSION} and {VERSION}",
            hint="move the file to another directory; the next run begins a new journal",
            file=str(path),
        )


def is_empty(connection: sqlite3.Connection) -> bool:
    """Return True if the database has no tables yet, for example because the disk was full or the power failed when it
    was created."""
    return _version(connection) == 0


def _version(connection: sqlite3.Connection) -> int:
    return int(connection.execute("PRAGMA user_version").fetchone()[0])
