"""Creation of the database tables of the journal, which records all runs, and migration of a journal of an older
version.
"""

from __future__ import annotations

import sqlite3
from importlib.resources import files

FILE_NAME = "journal.sqlite"

VERSION = 2
"""Version of the schema. In version 2 the column `aside` marks rows of withdrawals and returns, which are not part of
the procedure, and the table `origins` stores how a run started."""

_ASIDE = "ALTER TABLE {} ADD COLUMN aside INTEGER NOT NULL DEFAULT 0"
_TOUCHES = """CREATE VIEW touches AS
    SELECT run, ordinal, key, detail, finished AS at, result
    FROM steps WHERE kind = 'TouchTowards' AND result IS NOT NULL AND NOT aside"""


def prepare(connection: sqlite3.Connection) -> None:
    """Create or migrate the database tables of the journal in one transaction.

    After a power cut, the journal has either the old tables or the new ones. If the tables already have the structure
    of the current version, they are not changed.
    """
    connection.execute("PRAGMA journal_mode=WAL")
    connection.execute("PRAGMA synchronous=FULL")
    (found,) = connection.execute("PRAGMA user_version").fetchone()
    if found >= VERSION:
        return
    statements = (files(__package__) / "journal_schema.sql").read_text().split(";\n")
    connection.execute("BEGIN IMMEDIATE")
    try:
        for statement in statements:
            connection.execute(statement)
        for table in ("steps", "events", "decisions", "tables"):
            if not _has_aside(connection, table):
                connection.execute(_ASIDE.format(table))
        connection.execute("DROP VIEW IF EXISTS touches")
        connection.execute(_TOUCHES)
        connection.execute(f"PRAGMA user_version = {VERSION}")
    except BaseException:
        connection.execute("ROLLBACK")
        raise
    connection.execute("COMMIT")


def _has_aside(connection: sqlite3.Connection, table: str) -> bool:
    return any(row[1] == "aside" for row in connection.execute(f"PRAGMA table_info({table})"))
