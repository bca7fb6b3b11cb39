"""What tests of this folder need of the computer; where it is missing they are skipped aloud and counted."""

from __future__ import annotations

import pytest
from aloud import NOT_HERE

from simulators.linuxcnc.namespaces import unavailable_reason


def needing(missing: str) -> pytest.MarkDecorator:
    """Skipped where something is `missing`; empty: nothing is."""
    return pytest.mark.skipif(missing != "", reason=f"{NOT_HERE}: LinuxCNC cannot run: {missing}")


needs_linuxcnc = needing(unavailable_reason())
