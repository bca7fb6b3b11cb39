"""Random plans through the command that ten thousand of them go through: nothing hits anything, and the same comes
of the same seed."""

from __future__ import annotations

from campaign_command import run_campaign

from campaigns.sum import form_of

COUNT = 20


def test_random_plans_end_without_a_collision_and_most_are_accepted() -> None:
    code, result = run_campaign("plans", "--count", str(COUNT), "--seed", "3", "--judge-every", "5")
    assert code == 0, result
    assert result["passed"]
    assert result["plans"] == COUNT
    assert result["accepted"] >= 0.7 * COUNT
    assert {"-X", "+X", "-Z"} < set(result["accepted_by_spindle"]), "machines of every kind must be among them"
    assert result["accepted"] + sum(result["refused"].values()) == COUNT
    assert result["completed"] >= 0.9 * result["accepted"]
    assert sum(result["interrupted"].values()) == result["completed"]
    ends = {branch.rpartition(", ")[2] for branch in result["branches"]}
    assert {"accepted", "former table restored", "table confirmed", "refused"} == ends
    assert result["judged"] >= 2
    assert result["judged_collisions"] == 0
    assert result["judge_collisions"] > 0, "the judge must have seen collisions to be believed"
    assert result["judge_disagrees"] == []
    assert form_of(result).name == "plans"


def test_one_plan_comes_again_by_its_seed() -> None:
    first, second = (run_campaign("plans", "--only", "3000001") for _ in range(2))
    for _, result in (first, second):
        del result["wall_seconds"]
    assert first == second


def test_a_tip_that_rests_behind_its_touch_does_not_reach_the_holder() -> None:
    """Contact leaves 0.6 mm to a holder that leans towards the tip; braking from the fast touch takes them."""
    _, result = run_campaign("plans", "--only", "1007590")
    assert result["failures"] == []
    assert result["stopped"] == ""
    assert result["seen"]["smallest_mm"] > 0.4
