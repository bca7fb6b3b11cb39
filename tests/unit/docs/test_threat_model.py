"""Every row of the threat model names a test that exists, or says that the threat is not defended."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
PAGE = ROOT / "docs" / "explanation" / "threat-model.md"
ROWS = [line for line in PAGE.read_text(encoding="utf-8").splitlines() if re.match(r"\| \d+\.\d+", line)]
NAMED = re.compile(r"`(tests/[\w/]+\.py)(?:::(\w+))?`")


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.split("|")[2].strip()[:40])
def test_every_row_has_a_test_or_says_that_there_is_no_defence(row: str) -> None:
    defence = row.split("|")[3]
    named = NAMED.findall(defence)
    assert named or "not defended" in defence
    for file, test in named:
        text = (ROOT / file).read_text(encoding="utf-8")
        assert f"def {test}(" in text if test else "def test_" in text, f"{file}::{test}"


def test_the_page_has_rows_for_all_four_attackers() -> None:
    assert len(ROWS) > 30
    text = PAGE.read_text(encoding="utf-8")
    for heading in ("A process on the PC", "A host on the machine network", "A browser on the panel", "A stolen panel"):
        assert f"## {heading}\n" in text
