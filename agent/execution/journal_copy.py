"""Consistent copy of a journal, the database of all runs, with edited settings. The copy can be passed on to other
people.

The copy is made in a module of the journal because only these modules may contain SQL.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

from agent.errors import JournalFailed
from agent.execution.journal_reader import open_journal
from agent.execution.journal_schema import FILE_NAME
from agent.execution.stored_json import stored_json


def copy_journal(directory: Path, target: Path, edit_settings: Callable[[Any], Any]) -> Path:
    """Copy the journal of a state directory into the existing directory `target` and return the path of the copy.

    A run may write to the journal during the copy. `edit_settings` is called with the settings of each run, decoded
    from JSON, and returns the settings to be stored in the copy. The original settings do not remain in unused pages of
    the copied database file.

    Raises JournalFailed if the journal cannot be read or the copy cannot be written.
    """
    path = target / FILE_NAME
    with open_journal(directory, JournalFailed) as reader:
        reader.copy_to(path)
        with closing(sqlite3.connect(path)) as copy, copy:
            for run, text in copy.execute("SELECT run, settings FROM runs").fetchall():
                edited = json.dumps(edit_settings(stored_json(text)))
                copy.execute("UPDATE runs SET settings = ? WHERE run = ?", (edited, run))
        with closing(sqlite3.connect(path)) as copy:
            copy.execute("VACUUM")
    return path
