"""Simulated machines that the identification refuses: they are counted, and the figures are those of the others."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any

import pytest
from matplotlib.figure import Figure
from study_case import study_case

import twin.identification
from agent.errors import RunError
from agent.studies import monte_carlo, valuation
from agent.studies.identification_variants import IdentificationVariant
from agent.studies.monte_carlo import ErrorSample, RefusedMachine, SimulatedMachine
from agent.studies.procedure_value import ProcedureEvaluator, ProcedureVariant, Verdict
from agent.studies.study import StudyCase
from agent.studies.study_files import document
from agent.studies.true_effects import parse_effect
from twin.errors import PositionError, SingularSet, TwinError
from twin.identification import Options

Refuse = Callable[..., None]
MOVED = "position 3 moved between ball 3 and ball 4 by about 10 µm"


@pytest.fixture
def refuse(monkeypatch: pytest.MonkeyPatch) -> Refuse:
    """Return a function that lets the identification refuse its calls with the given numbers."""
    real = twin.identification.identify

    def install(
        calls: Collection[int], error: Callable[[], TwinError] = lambda: PositionError(3, MOVED[len("position 3 ") :])
    ) -> None:
        counted = iter(range(10**6))

        def identify(*arguments: Any) -> Any:
            if next(counted) in calls:
                raise error()
            return real(*arguments)

        monkeypatch.setattr(monte_carlo, "identify", identify)

    return install


def small(**changes: Any) -> StudyCase:
    return study_case(seed=5, position_set="S3", **changes)


def test_a_refused_machine_is_counted_and_the_others_are_as_before(refuse: Refuse) -> None:
    whole = monte_carlo.run(small())
    # call 0 identifies the planned centres, 1 to 4 the machines with scales as stated, 5 to 8 those as a run does
    refuse({6})
    found = monte_carlo.run(small())
    of = dict(zip(found.columns, zip(*found.rows, strict=True), strict=True))
    before = dict(zip(whole.columns, zip(*whole.rows, strict=True), strict=True))
    assert of["refused"] == (None, MOVED, None, None)
    assert of["ve_aligned_um"] == pytest.approx(before["ve_aligned_um"])
    assert of["vce_scales_as_stated_aligned_um"] == pytest.approx(before["vce_scales_as_stated_aligned_um"])
    left = [value for number, value in enumerate(before["vce_aligned_um"]) if number != 1]
    assert of["vce_aligned_um"][1] is None
    assert [value for value in of["vce_aligned_um"] if value is not None] == pytest.approx(left)
    said: dict[str, Any] = document(found)
    assert said["machines_refused"] == {"as_a_run_identifies": 1, "scales_as_stated": 0}
    assert said["refusals"]["as_a_run_identifies"] == [{"machine": 1, "reason": MOVED}]
    rms = (sum(value**2 for value in left) / 3) ** 0.5
    assert said["vce"]["aligned_um"] == pytest.approx(rms)
    figure = Figure()
    found.draw(figure)
    labels = figure.axes[0].get_legend_handles_labels()[1]
    assert labels[1] == "VCE, as a run identifies; 1 refused left out"


def test_more_than_half_refused_is_an_error_that_names_the_effects(refuse: Refuse) -> None:
    refuse({1, 2, 4})
    with pytest.raises(RunError, match=r"refuses 3 of 4 simulated machines, with drift=5um, .* machine 0: position 3"):
        monte_carlo.run(small(effects=(parse_effect("drift=5um"),)))


def test_half_of_them_is_none(refuse: Refuse) -> None:
    refuse({1, 2})
    said: dict[str, Any] = document(monte_carlo.run(small(effects=(parse_effect("drift=5um"),))))
    assert said["machines_refused"] == {"as_a_run_identifies": 0, "scales_as_stated": 2}


def test_a_set_that_identifies_nothing_is_no_refusal_of_machines(refuse: Refuse) -> None:
    refuse(range(100), lambda: SingularSet("nothing can be seen"))
    with pytest.raises(SingularSet, match="nothing can be seen"):
        monte_carlo.run(small())


class TestValuation:
    @pytest.fixture(autouse=True)
    def few_sets(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(valuation, "NAMED", ("S1", "S2", "S3"))
        monkeypatch.setattr(valuation, "RANDOM_SETS", 0)

    def test_refused_machines_and_sets_are_counted(self, refuse: Refuse) -> None:
        # four machines each: one of the first set is refused, and three of the second
        refuse({1, 4, 5, 6})
        found = valuation.run(small())
        of = dict(zip(found.columns, zip(*found.rows, strict=True), strict=True))
        assert of["machines_refused"] == (1, 3, 0)
        assert of["machines"] == (4, 4, 4)
        assert [value is None for value in of["simulated_vce_um"]] == [False, True, False]
        said: dict[str, Any] = document(found)
        assert (said["machines_refused"], said["sets_refused"], said["sets"]) == (4, 1, 3)
        assert -1.0 <= said["rank_correlation"] <= 1.0
        found.draw(Figure())

    def test_most_sets_refused_is_an_error_that_names_the_effects(self, refuse: Refuse) -> None:
        refuse(range(8), lambda: SingularSet("the identification does not converge"))
        with pytest.raises(RunError, match=r"8 of 8 simulated machines, with heat=2K, .* does not converge"):
            valuation.run(small(effects=(parse_effect("heat=2K"),)))


class TestVerdict:
    """The verdicts of the published studies."""

    def verdict(self, *reasons: tuple[str, bool]) -> Verdict:
        case = small()
        evaluator, variant = ProcedureEvaluator(case), IdentificationVariant(Options())
        trial = ProcedureVariant.of(case, case.artefact, case.positions())
        task = evaluator.procedure(trial, variant)
        machines = [task(number) for number in range(2)]
        assert all(isinstance(machine, SimulatedMachine) for machine in machines)
        others = [RefusedMachine(2 + n, machines[0].truth, *reason) for n, reason in enumerate(reasons)]
        closed = Verdict(evaluator.field.uncompensated())
        self.plain = ErrorSample.compensated(evaluator.field, machines)
        return closed.with_simulation(evaluator.field, [*machines, *others])

    def test_contradicting_machines_are_left_out(self) -> None:
        found = self.verdict((MOVED, False))
        assert found.simulated == self.plain.expected
        assert (found.machines, found.refused) == (2, 1)

    def test_if_they_are_the_most_nothing_is_simulated(self) -> None:
        found = self.verdict(*[(MOVED, False)] * 3)
        assert found.expected is not None
        assert (found.simulated, found.refused) == (None, 3)

    def test_one_without_an_estimate_is_a_set_that_does_not_identify(self) -> None:
        assert self.verdict(("the directions are open", True)) == Verdict(None)


@pytest.mark.parametrize("text", ["lobing=2um", "lobing=2\u00b5m", "lobing=2\u03bcm"])
def test_the_micro_sign_and_the_greek_letter_are_micrometres(text: str) -> None:
    assert str(parse_effect(text)) == "lobing=2um"
