"""Choice of the positions of a verification: the fewest, as many as usual if none are enough, on machines without a
squareness too."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from study_case import shipped_job

from agent.cli.printing import results_console
from agent.cli.run_commands.verification_table import power_notes, power_table, power_text
from agent.probing.measured_balls import no_correction
from agent.results.run_outcome import Decision, NightReport
from agent.runs.kinds.position_choice import PositionChooser
from agent.runs.kinds.verification_choice import VerificationChooser
from agent.runs.kinds.verification_power import verification_power
from agent.runs.kinds.verify import verified_report
from twin.identification import CarriedOverPrior
from twin.identification.scales import Scales
from twin.identification.unknowns import Unknowns
from twin.machine.error_model import SQUARENESS
from twin.monitoring.step_power import POWER, SmallestStep, StepPower


@cache
def chooser(step_urad: float = 10.0, *, square: bool = False) -> VerificationChooser:
    """Choice on the shipped machine after its planned calibration; if `square` is True, no squareness can change."""
    job = shipped_job(2)
    nightly = job.settings.nightly.model_copy(update={"verify_step_urad": step_urad})
    job = replace(job, settings=job.settings.model_copy(update={"nightly": nightly}))
    seen = job.step_visibility
    unknowns: Unknowns = seen.unknowns
    if square:
        own = [one.error in SQUARENESS for one in unknowns.model.parameters]
        unknowns = replace(unknowns, scale=np.where(own, 0.0, unknowns.scale))
    prior = CarriedOverPrior(unknowns, np.zeros(len(seen.covariance)), seen.covariance, Scales())
    return VerificationChooser.of(PositionChooser(job, 1), prior)


def test_the_fewest_positions_find_the_step_and_one_position_less_does_not() -> None:
    of = chooser()
    choice = of.choice()
    fewer = of.found(choice.positions[:-1])
    worst = choice.worst_squareness
    assert worst is not None
    assert worst.size is not None
    assert worst.size <= 10.0
    assert any(step.size is None or step.size > 10.0 for step in fewer.steps if step.error in SQUARENESS)
    assert all(of.power(choice.positions).power(e, 10.0, choice.evidence) >= POWER for e in SQUARENESS)


def test_the_step_that_is_stated_is_that_of_the_balls_which_were_measured() -> None:
    of = chooser()
    choice = of.choice()

    def stated(measured: StepPower) -> tuple[SmallestStep | None, str]:
        judgement = SimpleNamespace(report=NightReport(Decision.WITHIN, "run", 1.0, 1, 2), power=measured)
        judge: Any = SimpleNamespace(judge_balls=lambda *_: judgement)
        made = verified_report(judge, choice, (), no_correction)
        return made.finds, made.warning

    assert stated(of.power(choice.positions)) == (choice.worst_squareness, "")
    fewer = of.power(choice.positions[:1])
    finds, warning = stated(fewer)
    assert finds is not None
    assert finds.size is not None
    assert finds.size > 11.0
    assert fewer.power(finds.error, finds.size, choice.evidence) == pytest.approx(POWER)
    assert "less is found than planned" in warning
    nothing = replace(fewer, information=np.zeros_like(fewer.information))
    assert "not found" in stated(nothing)[1]


def test_a_machine_whose_touches_scatter_twice_as_much_finds_larger_steps_only() -> None:
    of = chooser()
    positions = of.choice().positions
    louder = VerificationChooser.of(PositionChooser(of.chooser.job, 1), replace(of.prior, scales=Scales(noise=2.0)))
    quiet, loud = (one.found(positions).worst_squareness for one in (of, louder))
    assert quiet is not None
    assert loud is not None
    assert quiet.size is not None
    assert loud.size is not None
    assert 1.2 * quiet.size < loud.size < 2.0 * quiet.size  # the drift since the last night scatters no more


def test_a_step_that_no_position_finds_takes_as_many_positions_as_a_night() -> None:
    of = chooser(1e-3)
    assert of.fewest(SQUARENESS, 1e-3) is None
    assert len(of.choice().positions) == 3


def test_a_machine_whose_squareness_cannot_change_is_verified_all_the_same() -> None:
    choice = chooser(square=True).choice()
    assert len(choice.positions) == 3
    assert choice.worst_squareness is None
    assert {step.error for step in choice.steps}.isdisjoint(SQUARENESS)


def test_the_table_of_a_machine_without_squareness_shows_what_is_measured_instead_and_says_why() -> None:
    job = shipped_job(2)
    family = job.machine.family
    own = [one.error in SQUARENESS for one in family.model.parameters]
    square = replace(family, half_widths=np.where(own, 0.0, family.half_widths))
    found = verification_power(replace(job, machine=replace(job.machine, family=square)), 1)
    assert not found.seeks_squareness
    assert found.by_positions == (found.planned,)
    assert len(found.planned.positions) == 3
    console = results_console()
    with console.capture() as shown:
        console.print(power_table(found))
    assert "volcal verify" in shown.get()
    for text in (power_notes(found), power_text(found)):
        assert "no squareness of this machine can change" in text
        assert "not found" not in text
        assert "not with all positions" not in text
