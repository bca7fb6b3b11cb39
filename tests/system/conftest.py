"""The trials of `benchmarks` are tests in small, too; they are no installed package."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))


@pytest.fixture
def state() -> Iterator[Path]:
    """State directory of a run, not yet created."""
    with TemporaryDirectory() as directory:
        yield Path(directory) / "state"
