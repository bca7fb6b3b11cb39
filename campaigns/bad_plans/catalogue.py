"""Catalogue of all bad plans. Each plan has a unique name."""

from __future__ import annotations

from campaigns.bad_plans.files import file_plans
from campaigns.bad_plans.mutation import BadPlan
from campaigns.bad_plans.numbers import number_plans
from campaigns.bad_plans.steps import step_plans


def bad_plans() -> list[BadPlan]:
    plans = [*file_plans(), *step_plans(), *number_plans()]
    assert len({bad.name for bad in plans}) == len(plans)
    return plans
