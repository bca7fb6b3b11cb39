"""The documentation points at what exists: links, anchors, folders and files named in running text."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
PAGES = sorted([ROOT / "README.md", ROOT / "systemd" / "README.md", *(ROOT / "docs").rglob("*.md")])
ROOTED = re.compile(r"^(agent|benchmarks|campaigns|config|docs|drivers|simulators|systemd|tests|twin|volcal)/[\w./-]*$")

FENCE = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)\s]+)\)")
CODE = re.compile(r"`([^`\n]+)`")
HEADING = re.compile(r"^#+ +(.+)$", re.MULTILINE)


def prose(page: Path) -> str:
    """The text of a page without its fenced blocks."""
    return FENCE.sub("", page.read_text(encoding="utf-8"))


def anchors(page: Path) -> set[str]:
    """As GitHub makes them: lower case, blanks to hyphens, other signs dropped."""
    kept = (re.sub(r"[^\w\- ]", "", heading.lower()) for heading in HEADING.findall(prose(page)))
    return {heading.strip().replace(" ", "-") for heading in kept}


def dead_links(page: Path) -> Iterator[str]:
    for target in LINK.findall(prose(page)):
        if target.startswith(("http://", "https://", "mailto:")):
            continue
        name, _, anchor = target.partition("#")
        place = (page.parent / name).resolve() if name else page
        wrong_anchor = anchor and place.suffix == ".md" and place.is_file() and anchor not in anchors(place)
        if not place.exists() or wrong_anchor:
            yield target


def missing_paths(page: Path) -> Iterator[str]:
    for code in CODE.findall(prose(page)):
        if ROOTED.match(code) and not (ROOT / code).exists():
            yield code


def by_name(page: Path) -> str:
    return str(page.relative_to(ROOT))


@pytest.mark.parametrize("page", PAGES, ids=by_name)
def test_every_relative_link_resolves(page: Path) -> None:
    assert list(dead_links(page)) == []


@pytest.mark.parametrize("page", PAGES, ids=by_name)
def test_every_path_in_the_text_exists(page: Path) -> None:
    assert list(missing_paths(page)) == []


def test_every_page_is_reached_from_the_index() -> None:
    index = ROOT / "docs" / "README.md"
    linked = {(index.parent / target.partition("#")[0]).resolve() for target in LINK.findall(prose(index))}
    assert [by_name(page) for page in (ROOT / "docs").rglob("*.md") if page != index and page not in linked] == []


def test_every_image_is_shown_somewhere() -> None:
    shown = {(page.parent / target).resolve() for page in PAGES for target in LINK.findall(prose(page))}
    assert set((ROOT / "docs" / "images").glob("*.png")) <= shown


def test_the_checks_see_what_is_wrong(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "# One thing\n[a](nowhere.md) [b](#one-thing) [c](#another) `agent/nothing.py` `agent/runs/guard.py`\n"
    )
    assert list(dead_links(page)) == ["nowhere.md", "#another"]
    assert list(missing_paths(page)) == ["agent/nothing.py"]
