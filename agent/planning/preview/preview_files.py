"""Files of the preview of a plan: a picture, and a self-contained HTML page that needs no network.

Either both files are written, or neither of them.
"""

from __future__ import annotations

from importlib import resources
from pathlib import Path

from markupsafe import Markup

from agent.errors import PlanRefused
from agent.files import write_all_atomically
from agent.html_templates import html_template
from agent.planning.job import Job, Planner
from agent.planning.preview.blob import embedded
from agent.planning.preview.builder import preview_of
from agent.planning.preview.figure import draw_png
from agent.planning.preview.scene import Preview

PICTURE, PAGE = "plan.png", "plan.html"
PROGRAM = ("camera.js", "model.js", "shapes.js", "painting.js", "controls.js", "input.js")
"""Scripts of the page in loading order, because each uses definitions of the scripts before it."""


def write_preview(job: Job, plan_of: Planner, folder: Path, refused: PlanRefused | None = None) -> list[Path]:
    """Write the preview of the plan that `plan_of` returns for `job` into `folder` and return the paths of the files.

    `refused` is the error with which the preflight refused the plan, or None if the plan passed.
    """
    preview = preview_of(job, plan_of, refused)
    write_all_atomically(folder, {PICTURE: draw_png(preview), PAGE: render_page(preview)})
    return [folder / PICTURE, folder / PAGE]


def render_page(preview: Preview) -> str:
    """Return the HTML text of the page that shows `preview`. The text depends only on `preview`."""
    return html_template("agent.planning.preview", "preview.html").render(
        preview=preview,
        css=_own("preview.css"),
        data=Markup(embedded(preview)),  # noqa: S704  JSON without any <
        program=Markup("\n").join(_own(name) for name in PROGRAM),
    )


def _own(name: str) -> Markup:
    text = resources.files("agent.planning.preview").joinpath(name).read_text(encoding="utf-8")
    return Markup(text)  # noqa: S704  our own file
