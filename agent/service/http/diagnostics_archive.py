"""Everything that helps to understand a failure, in one ZIP, with what is secret blanked."""

from __future__ import annotations

import io
import json
import platform
import re
import sqlite3
import tempfile
import zipfile
from collections.abc import Mapping, Sequence
from contextlib import closing
from importlib.metadata import distributions
from pathlib import Path
from typing import Any

from agent.execution.journal import FILE_NAME
from agent.service.control import Event
from agent.settings.schema import Settings

REMOVED = "(removed)"
_SECRET = re.compile(r"pass|secret|token|credential|private|api_?key|pin$|user", re.IGNORECASE)


def without_secrets(document: Any) -> Any:
    """The same with the values blanked whose key sounds like a secret, at any depth."""
    if isinstance(document, Mapping):
        return {
            key: REMOVED if _SECRET.search(str(key)) and value is not None else without_secrets(value)
            for key, value in document.items()
        }
    if isinstance(document, list):
        return [without_secrets(part) for part in document]
    return document


def diagnosis(settings: Settings, status: Mapping[str, Any], events: Sequence[Event]) -> bytes:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("status.json", _text(status))
        archive.writestr("events.json", _text([vars(event) for event in events]))
        archive.writestr("settings.json", _text(without_secrets(settings.model_dump(mode="json"))))
        archive.writestr("versions.json", _text(_versions()))
        journal = settings.state_directory / FILE_NAME
        if journal.is_file():
            archive.writestr(FILE_NAME, _journal_copy(journal))
    return content.getvalue()


def _journal_copy(path: Path) -> bytes:
    """A consistent copy, while a run may write; settings in it without their secrets."""
    with tempfile.TemporaryDirectory() as directory:
        target = Path(directory) / FILE_NAME
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True, timeout=2.0)) as source:
            source.execute("VACUUM INTO ?", (str(target),))
        with closing(sqlite3.connect(target)) as copy, copy:
            for run, text in copy.execute("SELECT run, settings FROM runs").fetchall():
                blanked = json.dumps(without_secrets(json.loads(text)))
                copy.execute("UPDATE runs SET settings = ? WHERE run = ?", (blanked, run))
        with closing(sqlite3.connect(target)) as copy:
            copy.execute("VACUUM")
        return target.read_bytes()


def _versions() -> dict[str, Any]:
    return {
        "python": platform.python_version(),
        "system": platform.platform(),
        "packages": {d.metadata["Name"]: d.version for d in distributions()},
    }


def _text(document: Any) -> str:
    return json.dumps(document, indent=1, default=str)
