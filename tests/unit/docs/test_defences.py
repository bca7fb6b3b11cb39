"""Every row of the threat model and of the safety case names a test that exists, or says that there is no defence."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
PAGES = ROOT / "docs" / "explanation"
THREATS = (PAGES / "threat-model.md").read_text(encoding="utf-8")
HAZARDS = (PAGES / "safety-case.md").read_text(encoding="utf-8")
ROWS = [line for line in THREATS.splitlines() if re.match(r"\| \d+\.\d+", line)]
BARRIERS = [
    line for line in HAZARDS.partition("## What was observed")[0].splitlines() if re.match(r"\| (?!barrier)\w", line)
]
NAMED = re.compile(r"`(tests/[\w/]+\.py)(?:::(\w+))?`")


@pytest.mark.parametrize("row", [*ROWS, *BARRIERS], ids=lambda row: row.split("|")[-3].strip()[:40])
def test_every_row_has_a_test_or_says_that_there_is_no_defence(row: str) -> None:
    defence = row.split("|")[-2]
    named = NAMED.findall(defence)
    assert named or "not defended" in defence or "at the next start only" in defence
    for file, test in named:
        text = (ROOT / file).read_text(encoding="utf-8")
        assert f"def {test}(" in text if test else "def test_" in text, f"{file}::{test}"
        only_long = "@pytest.mark.long" in text if not test else f"@pytest.mark.long\ndef {test}(" in text
        assert not only_long, f"{file}::{test} is not part of the check"


def test_the_threat_model_has_rows_for_all_four_attackers() -> None:
    assert len(ROWS) > 30
    for heading in ("A process on the PC", "A host on the machine network", "A browser on the panel", "A stolen panel"):
        assert f"## {heading}\n" in THREATS


def test_the_safety_case_has_barriers_against_every_hazard() -> None:
    hazards = HAZARDS.partition("## What was observed")[0].split("\n## H")[1:]
    assert len(hazards) == 5
    assert all(sum(row in hazard for row in BARRIERS) >= 5 for hazard in hazards)
