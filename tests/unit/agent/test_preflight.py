"""Refusals of the preflight for plans that cannot be carried out."""

from __future__ import annotations

from typing import Any

import pytest

from agent.errors import PlanRefused
from agent.planning.case_file import CASE_STUDY
from agent.planning.job import Job
from agent.planning.job_preparation import prepare_job
from agent.runs.kinds.calibrate import preflight_of
from agent.settings.load import load_settings

TOO_NEAR_MM = 12.0
"""Back from a ball by so little, a straight way along the bar of the case study runs into the balls between."""


def job(**procedure: Any) -> Job:
    settings = load_settings(CASE_STUDY)
    changed = settings.procedure.model_copy(update={"stations": (1,), **procedure})
    return prepare_job(settings.model_copy(update={"procedure": changed}), CASE_STUDY.parent)


def test_plain_ways_that_are_not_free_are_refused_with_the_way_out() -> None:
    with pytest.raises(PlanRefused, match=r"collision: tip with ball \d+") as refused:
        preflight_of(job(paths="plain", retract_mm=TOO_NEAR_MM))
    assert "step" in refused.value.where
    assert '`procedure.paths = "shortest"`' in refused.value.hint


def test_the_ways_that_the_hint_promises_are_free() -> None:
    assert preflight_of(job(retract_mm=TOO_NEAR_MM)).measured.positions
