"""Steps of a run against the walked branches: only steps that depend on measured values may differ."""

from __future__ import annotations

import pytest

from agent.planning.branch_walk import Branch
from campaigns.plans.steps_comparison import walked_branch

BALL = "measure/station-1/az45-el0/ball-03"
KEYS = (
    "before/active-bank",
    "measure/permissions",
    "measure/station-1/az45-el0/wait",
    "measure/station-1/az45-el0/orient",
    f"{BALL}/touch-0/via-0",
    f"{BALL}/touch-0/start",
    f"{BALL}/touch-0/find",
    f"{BALL}/touch-0/back-off",
    f"{BALL}/touch-0",
    f"{BALL}/touch-0/back",
    f"{BALL}/touch-1/above",
    f"{BALL}/touch-1/start",
    f"{BALL}/touch-1",
    "probe/station-1/az45-el0/ball-03/check/touch-0",
    "identify/choice",
)
END = len(KEYS)


def branch(*more: str, name: str = "kept") -> Branch:
    return Branch((name,), (*KEYS, *more), {}, (), {}, 0.0)


WRITTEN = branch("publish/stage", "activate/activate", name="written")
BOTH = [branch(), WRITTEN]


def test_a_run_with_the_same_steps_has_followed_the_branch() -> None:
    assert walked_branch(KEYS, BOTH) is BOTH[0]
    assert walked_branch(WRITTEN.keys, BOTH) is WRITTEN


@pytest.mark.parametrize(
    "more",
    [
        f"{BALL}/repeat-1/touch-0/start",
        f"{BALL}/again/repeat-2/touch-4",
        f"{BALL}/clean-up/touch-2",
        f"{BALL}/clean-up/touch-2/back",
        f"{BALL}/repeat-1/clean-up/touch-2",
        f"{BALL}/touch-1/via-3",
        f"{BALL}/away-0",
        f"{BALL}/off",
        "measure/station-1/az45-el0/out-2",
        "measure/station-1/az45-el0/settle-4/wait",
        "probe/station-1/az45-el0/ball-03/check/touch-7",
        "probe/station-1/az45-el0/ball-03/check/touch-7/above",
    ],
)
def test_steps_that_measured_values_add_are_permitted(more: str) -> None:
    assert walked_branch((*KEYS, more), BOTH) is BOTH[0]


@pytest.mark.parametrize("missing", [f"{BALL}/touch-0/via-0", f"{BALL}/touch-0/back", f"{BALL}/touch-1/start"])
def test_moves_that_measured_values_spare_are_permitted(missing: str) -> None:
    assert walked_branch([key for key in KEYS if key != missing], BOTH) is BOTH[0]


@pytest.mark.parametrize(
    ("missing", "follower"),
    [
        ("measure/permissions", "measure/station-1/az45-el0/wait"),
        ("measure/station-1/az45-el0/orient", f"{BALL}/touch-0/start"),
        (f"{BALL}/touch-0/start", f"{BALL}/touch-0/find"),
        (f"{BALL}/touch-0/back-off", f"{BALL}/touch-0"),
        (f"{BALL}/touch-1", "probe/station-1/az45-el0/ball-03/check/touch-0"),
        ("probe/station-1/az45-el0/ball-03/check/touch-0", "identify/choice"),
    ],
)
def test_a_step_that_is_missing_is_noticed(missing: str, follower: str) -> None:
    assert walked_branch([key for key in KEYS if key != missing], BOTH) == follower


@pytest.mark.parametrize("more", [f"{BALL}/touch-2", "publish/stage", "measure/station-1/az45-el0/leave"])
@pytest.mark.parametrize("place", [1, END - 1])
def test_a_step_that_was_not_walked_is_noticed(more: str, place: int) -> None:
    assert walked_branch((*KEYS[:place], more, *KEYS[place:]), BOTH) == more


def test_another_order_is_noticed() -> None:
    assert walked_branch((KEYS[1], KEYS[0], *KEYS[2:]), BOTH) == KEYS[1]


def test_a_run_that_ends_too_early_is_noticed() -> None:
    assert walked_branch(WRITTEN.keys[:-1], [WRITTEN]) == "activate/activate"
    assert walked_branch(KEYS[:-1], BOTH) == "identify/choice"


def test_the_branch_that_fits_longest_names_the_step() -> None:
    assert walked_branch((*KEYS, "publish/stage", "restore/activate"), BOTH) == "restore/activate"
