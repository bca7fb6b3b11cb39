"""The report on paper: the same page as PDF, A4, with running header and page numbers.

WeasyPrint draws figures by itself, where the page's CSS variables and `currentColor` do not reach: both are written out
in the colours of print.
"""

from __future__ import annotations

import hashlib
import logging
import re
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import resources

from drivers.errors import InputError

PRINT_COLOURS = {
    "currentColor": "#000000",
    "var(--grid)": "#dfe4e9",
    "var(--blue)": "#0072b2",
    "var(--orange)": "#c65102",
    "var(--green)": "#00805f",
    "var(--purple)": "#a3478a",
    "var(--figure-font)": "Liberation Sans, Arial, Helvetica, DejaVu Sans, sans-serif",
}
_SVG = re.compile(r"<svg .*?</svg>", re.DOTALL)


def render_pdf(page: str) -> bytes:
    """`page`: HTML of `render_report`. The same page gives the same bytes: no date is written, and the file's identity
    is that of its text. Nothing is fetched from anywhere. InputError where a part of it could not be drawn."""
    # half a second that only a PDF should cost
    from weasyprint import HTML  # type: ignore[import-untyped]  # noqa: PLC0415
    from weasyprint.urls import URLFetcher  # type: ignore[import-untyped]  # noqa: PLC0415

    style = resources.files("agent.reports.page").joinpath("print.css").read_text(encoding="utf-8")
    fetcher = URLFetcher(allowed_protocols=("data",))
    printed = _SVG.sub(lambda found: _in_print_colours(found[0]), page).replace("</style>", f"{style}</style>", 1)
    document = HTML(string=printed, url_fetcher=fetcher)
    identifier = hashlib.sha256(page.encode()).hexdigest()[:32].encode()
    with _fail_on_logged_errors():
        written = document.write_pdf(pdf_identifier=identifier)
    assert isinstance(written, bytes)  # noqa: S101  no target was named
    return written


def _in_print_colours(svg: str) -> str:
    for name, colour in PRINT_COLOURS.items():
        svg = svg.replace(name, colour)
    return svg


@contextmanager
def _fail_on_logged_errors() -> Iterator[None]:
    """The library leaves out what it cannot draw and tells its log; a report with a hole in it is none."""
    told: list[str] = []

    class Listening(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            told.append(record.getMessage())

    logger, listening = logging.getLogger("weasyprint"), Listening(logging.ERROR)
    logger.addHandler(listening)
    try:
        yield
    finally:
        logger.removeHandler(listening)
    if told:
        raise InputError(
            f"the report cannot be printed: {told[0]}", hint="print report.html from a browser, and report it"
        )
