"""Figures in the documents are those of runs: each block is compared with the command that made it."""

from __future__ import annotations

from pathlib import Path

import pytest

from campaigns.page_figures import FIGURES, block_of, differences
from drivers.errors import VolcalError


@pytest.mark.parametrize("name", FIGURES)
def test_the_figures_of_a_page_are_those_of_its_run(tmp_path: Path, name: str) -> None:
    path, source = FIGURES[name]
    stated = block_of(path.read_text(encoding="utf-8"), name)
    assert differences(stated, source(tmp_path)) == [], "run `make figures`"


@pytest.mark.parametrize(
    ("stated", "measured", "found"),
    [
        ("│ VE │ 11.81 µm │", "│  VE   │ 11.80 µm │", []),
        ("264 balls", "266 balls", []),
        ("264 balls", "300 balls", ["264 instead of 300"]),
        ("az -60", "az 60", ["-60 instead of 60"]),
        ("accepted", "refused", ["accepted instead of refused"]),
        ("3 stations", "3 stations more", ["2 words instead of 3"]),
    ],
)
def test_figures_may_differ_by_chance_and_words_not_at_all(stated: str, measured: str, found: list[str]) -> None:
    assert differences(stated, measured) == found


def test_a_page_without_its_block_says_so() -> None:
    with pytest.raises(VolcalError, match="no block 'demo'"):
        block_of("# A page\n", "demo")
