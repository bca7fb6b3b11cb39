"""What the tests of the driver share: one LinuxCNC for each file of tests."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from live import Live, running


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Live]:
    with running(tmp_path_factory.mktemp("linuxcnc") / "work") as machine:
        yield machine
