"""All bad plans, by name."""

from __future__ import annotations

from benchmarks.bad_plans.files import in_files
from benchmarks.bad_plans.mutation import Bad
from benchmarks.bad_plans.numbers import in_settings
from benchmarks.bad_plans.steps import in_steps


def bad_plans() -> list[Bad]:
    plans = [*in_files(), *in_steps(), *in_settings()]
    assert len({bad.name for bad in plans}) == len(plans)
    return plans
