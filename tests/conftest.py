"""What every test shares: one BLAS thread, and property tests that a check repeats exactly.

With `CI` set the examples of hypothesis are derived from the tests alone, so that a check that was green stays green
on the same tree; at a desk they are drawn anew each time, to find what is left.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is first imported; see agent/cli/main.py

from hypothesis import HealthCheck, settings

settings.register_profile("desk", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("check", parent=settings.get_profile("desk"), derandomize=True, database=None)
settings.load_profile("check" if os.environ.get("CI") else "desk")
