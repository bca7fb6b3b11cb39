"""All bad plans, by name."""

from __future__ import annotations

from campaigns.bad_plans.files import in_files
from campaigns.bad_plans.mutation import Bad
from campaigns.bad_plans.numbers import in_settings
from campaigns.bad_plans.steps import in_steps


def bad_plans() -> list[Bad]:
    plans = [*in_files(), *in_steps(), *in_settings()]
    assert len({bad.name for bad in plans}) == len(plans)
    return plans
