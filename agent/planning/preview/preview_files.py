"""The files of a preview: a picture and a page, both or none."""

from __future__ import annotations

from pathlib import Path

from agent.errors import PlanRefused
from agent.files import write_all_atomically
from agent.planning.job import Job
from agent.planning.preview.builder import preview_of
from agent.planning.preview.figure import draw_png
from agent.planning.preview.page import render_page

PICTURE, PAGE = "plan.png", "plan.html"


def write_preview(job: Job, folder: Path, refused: PlanRefused | None = None) -> list[Path]:
    """Draw the plan of `job` into `folder`; `refused`: what preflight had against it. The files written."""
    preview = preview_of(job, refused)
    write_all_atomically(folder, {PICTURE: draw_png(preview), PAGE: render_page(preview)})
    return [folder / PICTURE, folder / PAGE]
