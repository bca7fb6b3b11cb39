"""The lists of slow tests and of long files name what exists; `make quick` would run each slow test."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]


def lines_of(name: str) -> list[str]:
    lines = (ROOT / "tests" / name).read_text(encoding="utf-8").splitlines()
    return [line for line in lines if line and not line.startswith("#")]


def test_every_entry_is_a_test() -> None:
    entries = lines_of("slow.txt")
    assert entries == sorted(set(entries))
    for entry in entries:
        path, name, *_ = entry.split("::")  # a class may inherit its tests: its own name is in the file
        assert re.search(rf"\b{name}\b", (ROOT / path).read_text(encoding="utf-8")), entry


def test_every_entry_is_in_a_folder_that_the_quick_tests_collect() -> None:
    recipe = re.search(r"^quick:.*\n((?:\t.*\n)+)", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    assert recipe
    folders = tuple(f"{folder}/" for folder in re.findall(r"\btests/\w+", recipe[1]))
    assert folders
    assert [entry for entry in lines_of("slow.txt") if not entry.startswith(folders)] == []


def test_every_long_file_exists() -> None:
    files = lines_of("long_files.txt")
    assert len(files) == len(set(files))
    assert [path for path in files if not (ROOT / path).is_file()] == []
