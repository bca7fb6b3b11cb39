"""The report on paper: the same page as PDF, A4, with running header and page numbers.

WeasyPrint draws figures by itself, where the page's CSS variables and `currentColor` do not reach: both are written out
in the colours of print.
"""

from __future__ import annotations

import hashlib
import re
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
    is that of its text. Nothing is fetched from anywhere."""
    from weasyprint import CSS, HTML  # noqa: PLC0415  half a second that only a PDF should cost

    style = resources.files("agent.report").joinpath("print.css").read_text(encoding="utf-8")
    document = HTML(string=_SVG.sub(lambda found: _printed(found[0]), page), url_fetcher=_nothing_else)
    identifier = hashlib.sha256(page.encode()).hexdigest()[:32].encode()
    written = document.write_pdf(stylesheets=[CSS(string=style)], pdf_identifier=identifier)
    assert isinstance(written, bytes)  # noqa: S101  no target was named
    return written


def _printed(svg: str) -> str:
    for name, colour in PRINT_COLOURS.items():
        svg = svg.replace(name, colour)
    return svg


def _nothing_else(url: str, *_: object, **__: object) -> dict[str, object]:
    if url.startswith("data:"):
        from weasyprint import default_url_fetcher  # noqa: PLC0415

        found: dict[str, object] = default_url_fetcher(url)
        return found
    raise InputError("a report loads nothing from elsewhere", address=url)
