"""Download of a diagnostics archive for support. Secrets are removed from the archive."""

from __future__ import annotations

import io
import json
import platform
import tempfile
import zipfile
from collections.abc import Mapping, Sequence
from importlib.metadata import distributions
from pathlib import Path
from typing import Any

from fastapi import APIRouter
from fastapi.responses import Response

from agent.execution.journal_copy import copy_journal
from agent.execution.journal_reader import has_journal
from agent.execution.journal_schema import FILE_NAME
from agent.service.access.roles import DIAGNOSTICS
from agent.service.control import Event
from agent.service.http.app_state import AppStateDependency
from agent.service.http.permission import permitted
from agent.service.http.problems import DOCUMENTED
from agent.service.http.queries import status_now
from agent.settings.listing import without_secrets
from agent.settings.schema import Settings

router = APIRouter(prefix="/api", tags=["reading"], responses=DOCUMENTED, dependencies=[permitted(DIAGNOSTICS)])


@router.get("/diagnostics", response_class=Response)
def diagnostics(app_state: AppStateDependency) -> Response:
    """Return a ZIP file with status, events, versions, settings and journal, from which secrets are removed. The
    request requires the role engineer, because the file contains everything known about the machine."""
    _, events = app_state.event_log.since(0)
    content = diagnostics_zip(app_state.settings(), status_now(app_state).model_dump(mode="json"), events)
    headers = {"Content-Disposition": 'attachment; filename="volcal-diagnostics.zip"'}
    return Response(content, media_type="application/zip", headers=headers)


def diagnostics_zip(settings: Settings, status: Mapping[str, Any], events: Sequence[Event]) -> bytes:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("status.json", _text(status))
        archive.writestr("events.json", _text([vars(event) for event in events]))
        archive.writestr("settings.json", _text(without_secrets(settings.model_dump(mode="json"))))
        archive.writestr("versions.json", _text(_versions()))
        if has_journal(settings.state_directory):
            archive.writestr(FILE_NAME, _journal_copy(settings.state_directory))
    return content.getvalue()


def _journal_copy(state_directory: Path) -> bytes:
    """Return a copy of the journal as file content, with secrets removed from the settings. It is consistent even if a
    run is writing at the same time."""
    with tempfile.TemporaryDirectory() as directory:
        return copy_journal(state_directory, Path(directory), without_secrets).read_bytes()


def _versions() -> dict[str, Any]:
    return {
        "python": platform.python_version(),
        "system": platform.platform(),
        "packages": {d.metadata["Name"]: d.version for d in distributions()},
    }


def _text(document: Any) -> str:
    return json.dumps(document, indent=1, default=str)
