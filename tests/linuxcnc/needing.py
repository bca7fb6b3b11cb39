"""What tests of this folder need of the computer; where it is missing they are skipped aloud and counted."""

from __future__ import annotations

import pytest

from simulators.linuxcnc.namespaces import why_not

NOT_HERE = "NOT EXERCISED HERE: LinuxCNC cannot run"
WHY_NOT = why_not()

needs_linuxcnc = pytest.mark.skipif(WHY_NOT != "", reason=f"{NOT_HERE}: {WHY_NOT}")
