"""PDF of the report. It shows the content of the HTML page on A4 paper, with a running header and page numbers.

WeasyPrint, the library that makes the PDF, cannot use the page's CSS variables and `currentColor` in SVG figures. Both
are therefore replaced by print colours.
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
    """Return the PDF of `page`, the HTML text that `render_report` returns.

    Equal pages give equal bytes, because no date is written and the file identifier is a hash of the text. The network
    is not used. Raises InputError if a part of the page could not be drawn.
    """
    # import takes about 0.5 s, needed only for a PDF
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
    """Raise InputError for errors logged by the library, which omits parts that it cannot draw."""
    messages: list[str] = []

    class Collector(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            messages.append(record.getMessage())

    logger, collector = logging.getLogger("weasyprint"), Collector(logging.ERROR)
    logger.addHandler(collector)
    try:
        yield
    finally:
        logger.removeHandler(collector)
    if messages:
        raise InputError(
            f"the report cannot be converted to PDF: {messages[0]}",
            hint="print report.html from a browser, and report this error",
        )
