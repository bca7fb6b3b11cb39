"""Documents of the journal for clients, before the first run."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from agent.service.state.archive import Archive, UnknownRun


def test_lists_are_empty_before_the_first_run(tmp_path: Path) -> None:
    archive = Archive(tmp_path, lambda run_id: tmp_path / run_id)
    assert archive.runs(10) == archive.tables(10) == []


@pytest.mark.parametrize(
    "read",
    [
        lambda archive: archive.run("20260101-000000"),
        lambda archive: archive.balls("20260101-000000"),
        lambda archive: archive.temperatures("20260101-000000"),
        lambda archive: archive.events("20260101-000000", 10),
        lambda archive: archive.estimate("20260101-000000"),
        lambda archive: archive.report("20260101-000000"),
    ],
)
def test_a_run_is_not_found_before_the_first_one(tmp_path: Path, read: Callable[[Archive], object]) -> None:
    with pytest.raises(UnknownRun, match="there is no run yet"):
        read(Archive(tmp_path, lambda run_id: tmp_path / run_id))
