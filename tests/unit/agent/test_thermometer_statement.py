"""The thermometer of the settings: one uncertainty in every prediction and in the run, and the statements on it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

from agent.planning.case_file import CASE_STUDY, load_case
from agent.planning.cycle_time import set_alone
from agent.planning.design.design_problem import DesignProblem
from agent.planning.design.set_valuation import valuation_of
from agent.planning.identifiability import RankRequest, rank
from agent.planning.job import Job
from agent.probing.run_plan import MeasuredPositions
from agent.results.estimation import identification_options
from agent.results.predicted_accuracy import preflight_estimate
from agent.runs.kinds.calibrate import preflight_of
from agent.thermal.thermometer import ThermometerFacts, ThermometerStatement
from twin.artefact.position_set import parse_position_set
from twin.machine.volumetric import VolumetricRms
from twin.uncertainty.thermometer_effect import ThermometerEffect

STATED = [(None, 1.0), (0.0, 0.0), (0.4, 0.4)]


def job_with(uncertainty_k: float | None) -> Job:
    job = load_case(CASE_STUDY)
    temperature = job.settings.temperature.model_copy(update={"standard_uncertainty_k": uncertainty_k})
    return replace(job, settings=job.settings.model_copy(update={"temperature": temperature}))


@cache
def measured() -> MeasuredPositions:
    return preflight_of(load_case(CASE_STUDY)).measured


@pytest.mark.parametrize(("stated_k", "used_k"), STATED)
def test_the_run_and_every_prediction_of_it_use_the_same_number(stated_k: float | None, used_k: float) -> None:
    job = job_with(stated_k)
    run = identification_options(job.settings.identification, job.settings.temperature, None)
    assert run.temperature_standard_uncertainty_k == used_k
    assert DesignProblem({job.settings.tool: job}, 90.0, set_alone).options.temperature_standard_uncertainty_k == used_k
    predicted = preflight_estimate(job, measured()).unknowns.artefact
    assert predicted.thermometer_standard_uncertainty_k == used_k


def test_a_worse_thermometer_makes_a_set_worth_less() -> None:
    positions = parse_position_set("S3", 4)
    worth = [valuation_of(job_with(k), positions).percent for k in (0.0, 0.1, 0.4, None)]
    assert worth == sorted(worth, reverse=True)
    assert worth[0] - worth[-1] > 5.0


def test_rank_expects_the_error_with_the_thermometer_of_the_settings(tmp_path: Path) -> None:
    def expected_um(uncertainty_k: str) -> float:
        text = CASE_STUDY.read_text(encoding="utf-8").replace(
            "uncertainty_k = 0.1 ", f"uncertainty_k = {uncertainty_k} "
        )
        text = text.replace('= "machines/', f'= "{CASE_STUDY.parent}/machines/')
        (tmp_path / "volcal.toml").write_text(text.replace('= "artefacts/', f'= "{CASE_STUDY.parent}/artefacts/'))
        found = rank(RankRequest(tmp_path / "volcal.toml", grid_shape=(9, 5, 5)))
        return found.vce[0].aligned_um

    assert expected_um("1.0") > 1.1 * expected_um("0.1")


EFFECT = ThermometerEffect(0.5, 5.75e-6, VolumetricRms(0.003, 0.0028), VolumetricRms(0.004, 0.0033))


def test_the_report_says_what_the_thermometer_costs() -> None:
    facts = ThermometerFacts.of(EFFECT, ThermometerStatement.of(0.5, was_read=True))
    assert facts.text.startswith("Temperature of the artefact ±1 K (k = 2): scale ±11.5 µm/m. It contributes 2.80 µm")
    assert facts.short_text == "±0.5 K (as stated): 2.80 µm of the predicted VCE"
    assert facts.warning is None


@pytest.mark.parametrize(
    ("stated_k", "was_read", "used_k", "words"),
    [
        (None, True, 1.0, "uncertainty of the thermometer is not stated"),
        (None, False, 3.0, "was not measured"),
        (0.5, False, 0.5, "as stated"),
    ],
)
def test_what_nobody_stated_is_large_and_said(
    stated_k: float | None, was_read: bool, used_k: float, words: str
) -> None:
    statement = ThermometerStatement.of(stated_k, was_read)
    assert statement.standard_uncertainty_k == used_k
    warning = ThermometerFacts.of(EFFECT, statement).warning
    assert warning is not None
    assert words in warning
