"""The files of a preview: a picture and a page, both or none."""

from __future__ import annotations

import tempfile
from pathlib import Path

from agent.files import write_all_atomically
from agent.job import Job
from agent.preview.building import preview_of
from agent.preview.figure import draw_png
from agent.preview.page import render_page
from drivers.errors import InputError, PlanRefused

PICTURE, PAGE = "plan.png", "plan.html"


def check_folder(folder: Path) -> None:
    """Raise InputError where nothing could be written, before time is spent on a rehearsal; leaves no trace."""
    nearest = next(path for path in (folder.absolute(), *folder.absolute().parents) if path.exists())
    if not nearest.is_dir():
        raise InputError("this is a file, a directory is needed", hint="choose another directory", file=str(nearest))
    try:
        tempfile.TemporaryFile(dir=nearest).close()
    except OSError as cause:
        hint = "check the permissions and the free space, or choose another directory"
        message = f"the preview cannot be written: {(cause.strerror or str(cause)).lower()}"
        raise InputError(message, hint=hint, directory=str(folder)) from None


def write_preview(job: Job, folder: Path, refused: PlanRefused | None = None) -> list[Path]:
    """Draw the plan of `job` into `folder`; `refused`: what preflight had against it. The files written."""
    preview = preview_of(job, refused)
    write_all_atomically(folder, {PICTURE: draw_png(preview), PAGE: render_page(preview)})
    return [folder / PICTURE, folder / PAGE]
