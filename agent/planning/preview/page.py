"""The page: one file with data, style and program inside, so that it opens anywhere and asks no network."""

from __future__ import annotations

from importlib import resources

from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape
from markupsafe import Markup

from agent.planning.preview.blob import embedded
from agent.planning.preview.scene import Preview

PROGRAM = ("camera.js", "model.js", "shapes.js", "painting.js", "controls.js", "input.js")
"""In this order: each uses what those before it define."""


def render_page(preview: Preview) -> str:
    """HTML text; reads no clock and no device."""
    environment = Environment(
        loader=PackageLoader("agent.planning.preview", package_path=""),
        autoescape=select_autoescape(["html"]),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("preview.html").render(
        preview=preview,
        css=_own("preview.css"),
        data=Markup(embedded(preview)),  # noqa: S704  JSON without any <
        program=Markup("\n").join(_own(name) for name in PROGRAM),
    )


def _own(name: str) -> Markup:
    text = resources.files("agent.planning.preview").joinpath(name).read_text(encoding="utf-8")
    return Markup(text)  # noqa: S704  our own file
