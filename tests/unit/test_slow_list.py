"""The list of slow tests names tests that exist."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_every_entry_is_a_test() -> None:
    lines = (ROOT / "tests" / "slow.txt").read_text(encoding="utf-8").splitlines()
    entries = [line for line in lines if line and not line.startswith("#")]
    assert entries == sorted(set(entries))
    for entry in entries:
        path, name, *_ = entry.split("::")  # a class may inherit its tests: its own name is in the file
        assert re.search(rf"\b{name}\b", (ROOT / path).read_text(encoding="utf-8")), entry
