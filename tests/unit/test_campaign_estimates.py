"""Estimates that the nights of a campaign share: only those of the same job from the same measurements."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import agent.results.estimation
from agent.planning.job import Job
from campaigns.aborts.case import prepare_case
from campaigns.resume.case import cache_estimates
from twin.identification.options import Options

SECTIONS: dict[str, dict[str, Any]] = {"identification": {"order": 3}, "stations": {"standing_at": 1}}


def with_settings(**sections: dict[str, Any]) -> Callable[[Path], Job]:
    return lambda directory: prepare_case(directory, **{**SECTIONS, **sections})


def with_part(part: str, **changes: Any) -> Callable[[Path], Job]:
    def changed(directory: Path) -> Job:
        job = prepare_case(directory, **SECTIONS)
        return replace(job, **{part: replace(getattr(job, part), **changes)})

    return changed


OTHER_JOBS = {
    "order": with_settings(identification={"order": 4}),
    "table": with_settings(table={"step_mm": (500.0, 325.0, 250.0)}),
    "temperature": with_settings(temperature={"standard_uncertainty_k": 0.7}),
    "machine": with_part("machine", family="another"),
    "artefact": with_part("artefact", name="another"),
}


@pytest.fixture
def computed(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Measurements of the estimates that were computed."""
    done: list[Any] = []

    def compute(_: Job, observations: Any, options: Options) -> int:
        done.append((observations, options))
        return len(done)

    monkeypatch.setattr("campaigns.resume.case.estimate_for_job", compute)
    monkeypatch.setattr(agent.results.estimation, "estimate_for_job", compute)  # is put back after the test
    cache_estimates()
    return done


def estimate(job: Job, measured: tuple[float, ...] = (1.0, 2.0)) -> Any:
    observations: Any = measured
    return agent.results.estimation.estimate_for_job(job, observations, Options())


def folder(path: Path) -> Path:
    path.mkdir()
    return path


def test_nights_in_different_directories_share_an_estimate(tmp_path: Path, computed: list[Any]) -> None:
    jobs = [prepare_case(folder(tmp_path / name), **SECTIONS) for name in ("one", "two")]
    assert [estimate(job) for job in jobs] == [1, 1]
    assert [estimate(job, (1.0, 2.5)) for job in jobs] == [2, 2]
    assert len(computed) == 2


@pytest.mark.parametrize("what", OTHER_JOBS)
def test_another_job_has_its_own_estimate(tmp_path: Path, computed: list[Any], what: str) -> None:
    one = prepare_case(folder(tmp_path / "one"), **SECTIONS)
    other = OTHER_JOBS[what](folder(tmp_path / "other"))
    assert [estimate(one), estimate(other), estimate(one), estimate(other)] == [1, 2, 1, 2]
    assert len(computed) == 2


def test_a_further_trial_begins_without_estimates(tmp_path: Path, computed: list[Any]) -> None:
    job = prepare_case(tmp_path, **SECTIONS)
    assert estimate(job) == 1
    cache_estimates()
    assert estimate(job) == 2
    assert len(computed) == 2
