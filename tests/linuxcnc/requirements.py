"""Skip marks for tests that need LinuxCNC; skipped tests are reported and counted."""

from __future__ import annotations

import pytest
from aloud import NOT_HERE

from simulators.linuxcnc.namespaces import unavailable_reason


def skip_if_missing(missing: str) -> pytest.MarkDecorator:
    """Return a mark that skips the test, with `missing` as reason, unless `missing` is empty."""
    return pytest.mark.skipif(missing != "", reason=f"{NOT_HERE}: LinuxCNC cannot run: {missing}")


requires_linuxcnc = skip_if_missing(unavailable_reason())
