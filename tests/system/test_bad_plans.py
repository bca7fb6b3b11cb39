"""Each bad plan is refused by the check of its settings or by the preflight, for the right reason; nothing moves."""

from __future__ import annotations

from pathlib import Path

import pytest

from campaigns.bad_plans.catalogue import bad_plans
from campaigns.bad_plans.mutation import BadPlan, check_case, unchanged

BAD_PLANS = bad_plans()


def test_the_plan_that_is_mutated_is_good(tmp_path: Path) -> None:
    check_case(unchanged, tmp_path, BAD_PLANS[0].preflight)


def test_there_are_more_than_a_hundred_of_them_beside_wrong_numbers() -> None:
    assert sum(bad.name.startswith("steps: ") for bad in BAD_PLANS) > 50
    assert len(BAD_PLANS) > 500


@pytest.mark.parametrize("bad", BAD_PLANS, ids=lambda bad: bad.name)
def test_refused_for_the_right_reason(bad: BadPlan, tmp_path: Path) -> None:
    assert bad.complaint(tmp_path) == ""
