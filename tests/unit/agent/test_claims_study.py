"""Claims of the publication: the bend of a front, verdicts from findings, and errors of single machines against the
exact residual field on the grid."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from study_case import study_case

from agent.studies.measure import ALIGNED, MEASURES
from agent.studies.published import claims
from agent.studies.published.claims import DOES_NOT_HOLD, HOLDS, ClaimFinding, verdict
from agent.studies.published.procedures import (
    COUNTS,
    KEYS,
    EvaluationTask,
    Outcomes,
    ProcedureKey,
    RemainingErrors,
    StudiedMachine,
    bent,
)
from twin.arrays import Array
from twin.artefact.position_set import SET_EXPRESSIONS


def errors(value_um: float, *machines_um: float, cost: int = 0) -> RemainingErrors:
    each: dict[str, Array] = {one.key: np.array(machines_um or (value_um,)) for one in MEASURES}
    return RemainingErrors({one.key: value_um for one in MEASURES}, each, cost)


def outcomes(after: Mapping[ProcedureKey, RemainingErrors | None], before: RemainingErrors) -> Outcomes:
    made = StudiedMachine.of(study_case(seed=1))
    every: dict[ProcedureKey, RemainingErrors | None] = dict.fromkeys(KEYS)
    return Outcomes("one", "bar", made.variants[0], ALIGNED, before, {**every, **after})


def finding(machine: str, reading: str, measure: str, holds: bool) -> ClaimFinding:
    return ClaimFinding(machine, reading, measure, 1.0, holds)


class TestBend:
    def test_it_is_farthest_below_the_line_from_the_cheapest_to_the_best(self) -> None:
        assert bent([10, 20, 40, 60, 100], [10.0, 8.0, 3.0, 2.8, 2.0]) == 2

    def test_a_dominated_point_is_never_at_the_bend(self) -> None:
        assert bent([10, 20, 21, 100], [10.0, 9.9, 3.0, 2.0]) == 2
        assert bent([10, 20, 100], [10.0, 10.5, 2.0]) == 2

    def test_a_straight_front_has_its_best_point(self) -> None:
        assert bent([0, 10, 20], [4.0, 3.0, 2.0]) == 2

    def test_the_units_do_not_matter(self) -> None:
        costs, values = [15.0, 32.0, 47.0, 61.0], [6.7, 5.4, 2.8, 2.5]
        assert bent(costs, values) == bent([60 * c for c in costs], [1e3 * v for v in values]) == 2


class TestVerdict:
    def test_one_finding_everywhere_is_said_plainly(self) -> None:
        assert verdict([finding("a", "published", "raw", True), finding("b", "volcal", "aligned", True)]) == HOLDS
        assert verdict([finding("a", "published", "raw", False)]) == DOES_NOT_HOLD

    def test_the_factor_that_decides_is_named(self) -> None:
        every = [
            finding(machine, reading, measure, holds=reading == "volcal")
            for machine in ("a", "b")
            for reading in ("published", "volcal")
            for measure in ("raw", "aligned")
        ]
        assert verdict(every) == "depends on reading"
        assert verdict([replace(one, holds=one.holds and one.machine == "a") for one in every]) == (
            "depends on machine and reading"
        )


class TestClaims:
    def test_the_share_of_seven_balls_is_that_of_the_best_number(self) -> None:
        left = dict(zip(COUNTS, (8.0, 5.0, 4.2, 4.1, 4.0, 4.0), strict=True))
        after = {ProcedureKey("S3", balls=count): errors(value, value, 9.0) for count, value in left.items()}
        found = claims.CLAIMS[0].examine(outcomes(after, errors(10.0, 10.0, 10.0)))
        assert found.value == pytest.approx((10.0 - 4.2) / 6.0)
        assert found.holds
        assert found.share == 1.0

    def test_a_machine_that_is_not_identified_has_no_value(self) -> None:
        found = claims.CLAIMS[0].examine(outcomes({}, errors(10.0)))
        assert (found.value, found.holds, found.band) == (None, False, None)

    def test_the_choice_names_the_set_at_the_bend(self) -> None:
        left = dict(zip(SET_EXPRESSIONS, (7.0, 6.0, 5.5, 3.0, 2.8, 2.7, 2.6), strict=True))
        costs = dict(zip(SET_EXPRESSIONS, (78, 176, 264, 254, 342, 440, 518), strict=True))
        after = {ProcedureKey(name): errors(left[name], cost=costs[name]) for name in SET_EXPRESSIONS}
        found = claims.choice_of_set(outcomes(after, errors(10.0)))
        assert found.answer == SET_EXPRESSIONS[3] == "S1+S2"
        assert not found.holds

    def test_every_claim_has_a_text(self) -> None:
        assert set(claims.TEXTS) == {*(one.name for one in claims.CLAIMS), claims.CHOICE, claims.DIFFERENCE}


class TestSingleMachines:
    def test_their_mean_square_is_that_of_the_closed_form(self) -> None:
        made = StudiedMachine.of(study_case(seed=3, machines=3000))
        before = EvaluationTask((made,), 3)((0, 0, -1))
        after = EvaluationTask((made,), 3)((0, 1, KEYS.index(ProcedureKey("S2", tilt_deg=30.0))))
        for found in (before, after):
            assert found is not None
            for measure in MEASURES:
                rms = math.sqrt(float(np.mean(found.machines_um[measure.key] ** 2)))
                assert rms == pytest.approx(found.expected_um[measure.key], rel=0.03)

    def test_the_machines_are_the_same_for_every_procedure(self) -> None:
        made = StudiedMachine.of(study_case(seed=3, machines=40))
        task = EvaluationTask((made,), 3)
        three, five = (task((0, 1, KEYS.index(ProcedureKey("S3", balls=count)))) for count in (3, 5))
        assert three is not None and five is not None
        together = np.corrcoef(three.machines_um[ALIGNED.key], five.machines_um[ALIGNED.key])[0, 1]
        assert together > 0.3
