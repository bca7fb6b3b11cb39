"""Fixtures of the driver tests: one LinuxCNC for each test file."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from live import Live, running


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Live]:
    with running(tmp_path_factory.mktemp("linuxcnc") / "work") as machine:
        yield machine
