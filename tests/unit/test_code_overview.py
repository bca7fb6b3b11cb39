"""Files, folders and names in the explanations of the code exist in the repository."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
EXPLANATION = ROOT / "docs" / "explanation"
CODE = re.compile(r"`([^`\n]+)`")
NAME = re.compile(r"[A-Za-z]\w*")
FOLDERS = tuple(f"{path.name}/" for path in ROOT.iterdir() if path.is_dir() and not path.name.startswith("."))
CHANGES = re.split(r"^### ", (EXPLANATION / "code-overview.md").read_text(encoding="utf-8"), flags=re.MULTILINE)[1:]


def paths(text: str) -> set[str]:
    """The words in code style that begin with a folder of the repository."""
    return {word for word in CODE.findall(text) if word.startswith(FOLDERS)}


def contents(path: Path) -> str:
    """The text of a file, or of all modules of a folder."""
    files = sorted(path.glob("*.py")) if path.is_dir() else [path]
    return "\n".join(file.read_text(encoding="utf-8") for file in files)


@pytest.mark.parametrize("page", ["code-overview.md", "architecture.md", "one-touch.md"])
def test_every_path_on_the_page_exists(page: str) -> None:
    named = paths((EXPLANATION / page).read_text(encoding="utf-8"))
    assert named
    assert [path for path in sorted(named) if not (ROOT / path).exists()] == []


def test_ten_changes_are_worked() -> None:
    assert len(CHANGES) == 10


@pytest.mark.parametrize("change", CHANGES, ids=[change.split("\n", 1)[0] for change in CHANGES])
def test_every_name_of_a_change_stands_in_a_file_of_the_change(change: str) -> None:
    text = "\n".join(contents(ROOT / path) for path in sorted(paths(change)))
    names = [word for word in CODE.findall(change) if NAME.fullmatch(word) and not (ROOT / word).exists()]
    assert [name for name in names if re.search(rf"\b{name}\b", text) is None] == []
