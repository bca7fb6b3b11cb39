"""Search against exhaustive choice and plain evaluation, on artificial candidates."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.artefact.position_set import Position
from twin.design.candidates import CandidatePositions, orientation_grid
from twin.design.criterion import Criterion
from twin.design.goals import PositionCountGoal, TargetErrorGoal, TimeSlotGoal
from twin.design.held_out import least_known_positions, most_informative_groups
from twin.design.information import InformationState
from twin.design.measuring_cost import MeasuringCosts
from twin.design.search import ExchangeSearch, Selection
from twin.errors import DataError


def made_up(seed: int, count: int = 9, rank: int = 2, size: int = 6) -> CandidatePositions:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(size, size))
    form = root @ root.T
    positions = tuple(Position(1 + index % 3, float(index), 0.0) for index in range(count))
    precision = np.diag(rng.uniform(0.5, 2.0, size))
    return CandidatePositions(
        positions, np.full(count, 3), rng.normal(size=(count, rank, size)), precision, Criterion(form, form)
    )


def plain_value(candidates: CandidatePositions, chosen) -> float:
    """Return trace(Q C), where C is the inverse of the summed information of all positions."""
    precision = candidates.precision.copy()
    for index in chosen:
        precision += candidates.factors[index].T @ candidates.factors[index]
    return float(np.trace(candidates.form.aligned @ np.linalg.inv(precision)))


def searching(candidates: CandidatePositions, **more) -> ExchangeSearch:
    stations = np.array([position.station for position in candidates.positions])
    prices = MeasuringCosts(np.linspace(1.0, 2.0, candidates.count), stations, more.pop("carry_minutes", 0.0))
    return ExchangeSearch(candidates, prices, min_improvement=0.0, **more)


def test_gains_and_losses_are_those_of_a_plain_evaluation():
    candidates = made_up(1)
    information = InformationState.initial(candidates.factors, candidates.form.aligned, candidates.covariance([]))
    chosen: list[int] = []
    for index in (4, 0, 7):
        here = plain_value(candidates, chosen)
        plain = [here - plain_value(candidates, [*chosen, other]) for other in range(candidates.count)]
        np.testing.assert_allclose(information.gains(), plain, rtol=1e-9)
        information = information.after_adding(candidates.factors[index])
        chosen.append(index)
    losses = [plain_value(candidates, [o for o in chosen if o != index]) - information.value for index in chosen]
    np.testing.assert_allclose(information.losses(np.array(chosen)), losses, rtol=1e-9)


def test_a_position_taken_back_leaves_what_was_known_before():
    candidates = made_up(2)
    selection = Selection.of(candidates, (1, 5))
    again = selection.with_added(3).with_removed(3)
    assert again.chosen == selection.chosen
    np.testing.assert_allclose(again.information.covariance, selection.information.covariance, atol=1e-12)
    np.testing.assert_allclose(again.information.weight, selection.information.weight, atol=1e-11)
    assert selection.value == pytest.approx(plain_value(candidates, (1, 5)), rel=1e-12)


@pytest.mark.parametrize("seed", range(12))
def test_the_search_comes_near_the_best_of_all_subsets(seed: int):
    candidates = made_up(seed)
    best = min(plain_value(candidates, chosen) for chosen in combinations(range(candidates.count), 3))
    found = plain_value(candidates, PositionCountGoal(3).select(searching(candidates)))
    assert (
        best * (1.0 - 1e-12) <= found <= 1.06 * best
    )  # exchanges one at a time end when no single exchange improves the result


def test_the_search_mostly_finds_the_very_best():
    hits = 0
    for seed in range(12):
        candidates = made_up(seed)
        best = min(combinations(range(candidates.count), 3), key=lambda chosen: plain_value(candidates, chosen))
        hits += set(best) == set(PositionCountGoal(3).select(searching(candidates)))
    assert hits >= 9


@given(st.integers(0, 10_000), st.permutations(range(9)))
def test_no_position_ever_does_harm(seed: int, order: list[int]):
    selection = Selection.of(made_up(seed))
    for index in order:
        further = selection.with_added(index)
        assert further.value <= selection.value * (1.0 + 1e-12)
        selection = further


def test_a_slot_holds_and_no_position_that_fits_is_left_out():
    candidates = made_up(3)
    search = searching(candidates, carry_minutes=1.5)
    chosen = TimeSlotGoal(8.0).select(search)
    assert len(set(chosen)) == len(chosen) >= 2
    assert search.costs.total(chosen) <= 8.0
    rest = [index for index in range(candidates.count) if index not in chosen]
    assert all(search.costs.total([*chosen, index]) > 8.0 for index in rest)


@given(st.integers(0, 200), st.sets(st.integers(0, 8), min_size=2), st.floats(4.0, 14.0))
def test_a_selection_that_fits_its_slot_is_improved_and_keeps_to_it(seed: int, start: set[int], slot: float):
    candidates = made_up(seed)
    search = searching(candidates, carry_minutes=0.5)
    chosen = TimeSlotGoal(slot).select(search, sorted(start))
    assert len(set(chosen)) == len(chosen) >= 2
    assert search.costs.total(chosen) <= slot
    if search.costs.total(sorted(start)) <= slot:
        assert plain_value(candidates, chosen) <= plain_value(candidates, start) * (1.0 + 1e-9)
    rest = [index for index in range(candidates.count) if index not in chosen]
    assert all(search.costs.total([*chosen, index]) > slot for index in rest)


def test_a_selection_that_is_too_long_loses_the_positions_that_matter_least():
    candidates = made_up(3)
    search = searching(candidates)
    whole = list(range(candidates.count))
    slot = search.costs.total(whole) - 0.1  # the shortest position takes longer
    chosen = TimeSlotGoal(slot).select(search, whole)
    least = min(plain_value(candidates, [o for o in whole if o != index]) for index in whole)
    assert plain_value(candidates, chosen) == pytest.approx(least, rel=1e-9)


def test_a_selection_of_which_one_position_is_left_is_replaced_by_a_new_one():
    candidates = made_up(12)
    search = searching(candidates, carry_minutes=3.0)
    cheapest = float(search.costs.cheapest_pairs().min())
    slot = cheapest + 0.05
    chosen = TimeSlotGoal(slot).select(search, [7, 8])  # at two stations, far too long
    assert search.costs.total([7, 8]) > slot
    assert len(chosen) >= 2
    assert search.costs.total(chosen) <= slot
    assert chosen == TimeSlotGoal(slot).select(search)


def test_a_slot_is_used_nearly_as_well_as_by_the_best_of_all_sets():
    candidates = made_up(4, count=8)
    search = searching(candidates, carry_minutes=0.5)
    fitting = [
        chosen for size in range(2, 9) for chosen in combinations(range(8), size) if search.costs.total(chosen) <= 6.0
    ]
    best = min(plain_value(candidates, chosen) for chosen in fitting)
    assert plain_value(candidates, TimeSlotGoal(6.0).select(search)) <= 1.05 * best


def test_the_price_of_a_set_counts_one_carry_for_each_station_but_where_the_mount_stands():
    prices = MeasuringCosts(np.array([1.0, 2.0, 4.0]), np.array([1, 2, 2]), carry_minutes=10.0, standing_at=1)
    assert prices.total([0]) == 1.0
    assert prices.total([1, 2]) == 16.0
    assert prices.total([0, 1, 2]) == 17.0
    assert prices.marginal([1]).tolist() == [1.0, 2.0, 4.0]
    assert prices.marginal([]).tolist() == [1.0, 12.0, 14.0]
    assert prices.cheapest_pairs().tolist() == [13.0, 13.0, 15.0]


def test_a_target_is_reached_and_nothing_can_be_spared():
    candidates = made_up(5)
    search = searching(candidates)
    wanted_mm = float(np.sqrt(plain_value(candidates, PositionCountGoal(5).select(search))))
    chosen = TargetErrorGoal(wanted_mm).select(search)
    assert np.sqrt(plain_value(candidates, chosen)) <= wanted_mm * (1.0 + 1e-9)
    for index in chosen:
        rest = [other for other in chosen if other != index]
        assert np.sqrt(plain_value(candidates, rest)) > wanted_mm


def test_goals_that_cannot_be_reached_say_what_can():
    candidates = made_up(6)
    search = searching(candidates)
    with pytest.raises(DataError, match="cannot separate machine errors from artefact errors"):
        PositionCountGoal(1)
    with pytest.raises(DataError, match="only 9 positions"):
        PositionCountGoal(10).select(search)
    with pytest.raises(DataError, match=r"shortest two take 2\.1 min"):
        TimeSlotGoal(2.0).select(search)
    floor_um = 1e3 * np.sqrt(plain_value(candidates, range(9)))
    with pytest.raises(DataError, match=f"{floor_um:.2f} µm remain"):
        TargetErrorGoal(0.999e-3 * floor_um).select(search)


def test_what_does_not_pass_is_never_chosen():
    candidates = made_up(7)
    free = PositionCountGoal(4).select(searching(candidates))
    barred = set(free[:2])
    chosen = PositionCountGoal(4).select(searching(candidates, is_measurable=lambda index: index not in barred))
    assert not barred & set(chosen)
    assert plain_value(candidates, chosen) >= plain_value(candidates, free)
    with pytest.raises(DataError, match="only 1 positions"):
        PositionCountGoal(2).select(searching(candidates, is_measurable=lambda index: index == 3))


def test_held_out_groups_are_those_that_would_have_told_most():
    candidates = made_up(8)
    groups = [[0, 3], [1, 4], [2, 5], [6, 7]]
    chosen = [8, 6]
    allowed = groups[:3]
    first = min(allowed, key=lambda group: plain_value(candidates, [*chosen, *group]))
    rest = [group for group in allowed if group != first]
    second = min(rest, key=lambda group: plain_value(candidates, [*chosen, *first, *group]))
    assert most_informative_groups(candidates, chosen, groups, 2) == [first, second]
    with pytest.raises(DataError, match="4 orientations are to be held out, but only 3 can be measured"):
        most_informative_groups(candidates, chosen, groups, 4)


def plain_errors(candidates: CandidatePositions, chosen) -> list[float]:
    """Return for each candidate the expected square of a ball's residual if `chosen` were measured; the last unknown is
    one of the artefact."""
    precision = candidates.precision.copy()
    for index in chosen:
        precision += candidates.factors[index].T @ candidates.factors[index]
    covariance = np.linalg.inv(precision)[:-1, :-1]
    rows = candidates.factors[:, :, :-1]
    return [
        float(np.trace(row @ covariance @ row.T)) / balls for row, balls in zip(rows, candidates.balls, strict=True)
    ]


def test_least_known_positions_are_those_whose_balls_are_expected_to_be_worst():
    made = made_up(9)
    form = made.form.raw.copy()
    form[-1], form[:, -1] = 0.0, 0.0
    balls = np.arange(3, 3 + made.count)
    candidates = replace(made, balls=balls, form=Criterion(form, form))
    chosen = [2, 5]
    expected: list[int] = []
    for _ in range(3):
        errors = plain_errors(candidates, [*chosen, *expected])
        left = [index for index in range(candidates.count) if index not in (*chosen, *expected, 7)]
        expected.append(max(left, key=errors.__getitem__))
    assert least_known_positions(candidates, chosen, 3, lambda index: index != 7) == expected


def test_least_known_positions_are_fewer_if_fewer_can_be_measured():
    candidates = made_up(10)
    assert least_known_positions(candidates, [0], 4, lambda index: index in (0, 3)) == [3]
    assert least_known_positions(candidates, [0], 4, lambda _: False) == []


def test_of_equal_positions_the_first_is_held_out():
    made = made_up(11)
    candidates = replace(made, factors=made.factors[[4] * made.count] * (1.0 + 1e-9 * np.arange(9)[:, None, None]))
    assert least_known_positions(candidates, [], 1, lambda _: True) == [0]


@pytest.mark.parametrize("step", [0.0, -15.0, 7.0, 100.0, 60.0, float("nan")])
def test_a_grid_must_divide_a_right_angle(step: float):
    with pytest.raises(DataError, match="does not divide 90"):
        orientation_grid(step)


def test_a_grid_that_fills_the_memory_is_refused():
    with pytest.raises(DataError, match=r"the grid step 1e-06° is less than 2\.5°"):
        orientation_grid(1e-6)
    assert len(orientation_grid(2.5)) == 10_512


def test_the_grid_goes_all_around_once():
    angles = orientation_grid(15.0)
    assert len(angles) == len(set(angles)) == 24 * 13
    assert {azimuth for azimuth, _ in angles} == {float(a) for a in range(-165, 181, 15)}
    assert {elevation for _, elevation in angles} == {float(e) for e in range(-90, 91, 15)}
