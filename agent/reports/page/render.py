"""Rendering of the report as one self-contained page with figures and style."""

from __future__ import annotations

from importlib import resources

from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape
from markupsafe import Markup

from agent.reports.page.data import ReportData
from agent.reports.page.figures import report_figures
from agent.reports.page.page import page_values
from agent.reports.page.texts import ENGLISH, Texts


def render_report(data: ReportData, texts: Texts = ENGLISH) -> str:
    """Return the HTML text of the whole report. Equal data always give equal bytes. Rendering takes a few seconds at
    most."""
    environment = Environment(
        loader=PackageLoader("agent.reports.page", package_path=""),
        autoescape=select_autoescape(["html"]),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    style = resources.files("agent.reports.page").joinpath("report.css").read_text(encoding="utf-8")
    figures = {name: Markup(svg) for name, svg in report_figures(data).items()}  # noqa: S704  drawn by ourselves
    return environment.get_template("report.html").render(
        css=Markup(style),  # noqa: S704  a file of this package
        **page_values(data, texts),
        **figures,
    )
