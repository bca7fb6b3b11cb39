"""Nights on a machine that drifts in other ways than the program assumes: what is predicted stays true, and a night
that does not fit is named."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from case_study_files import MACHINE_FILE
from click.testing import CliRunner

from agent.cli.offline_commands.identify import identify
from campaigns.foreign.files import artefact_text, ball_text, rows_of
from campaigns.foreign.nights import (
    NIGHTS,
    STATED_UM,
    STEP_NIGHT,
    Change,
    MeasuredNight,
    NightScore,
    drift,
    fused_nights,
    measured_nights,
    one_axis_only,
    season,
    step,
    still,
    straightness_steps,
    walk_of_everything,
)
from twin.formats.estimate_file import format_estimate, parse_estimate

WINDOW = 10


sixty_nights = cache(fused_nights)


def window_means(nights: list[NightScore]) -> np.ndarray:
    return np.array([night.ratio for night in nights]).reshape(-1, WINDOW).mean(axis=1)


def told(change: Change, nights: list[NightScore]) -> str:
    worst = max(nights, key=lambda night: night.ratio)
    return (
        f"{change.__name__}: true/predicted {np.round(window_means(nights), 2)}, worst night {worst.number}: "
        f"{worst.true_um:.2f} µm against {worst.predicted_um:.2f} predicted ({worst.ratio:.2f}); "
        f"not fitting: {[night.number for night in nights if not night.fit.fits]}; "
        f"drift factor {nights[-1].fit.factor:.2f}"
    )


@pytest.mark.parametrize("change", [straightness_steps, season, one_axis_only])
def test_sixty_nights_stay_truthful(change: Change, record_property: Callable[[str, object], None]) -> None:
    nights = sixty_nights(change)
    summary = told(change, nights)
    record_property("nights", summary)
    assert len(nights) == NIGHTS
    means = window_means(nights)
    assert ((means > 0.7) & (means < 1.6)).all(), summary
    assert 0.75 < means.mean() < 1.33, summary
    calm = [night for night in nights if not (change is straightness_steps and night.number == STEP_NIGHT)]
    assert max(night.ratio for night in calm) < 2.0, summary
    not_fitting = [night.number for night in nights if not night.fit.fits]
    assert len([number for number in not_fitting if number != STEP_NIGHT]) <= 2, summary
    assert change is not straightness_steps or STEP_NIGHT in not_fitting, summary


def test_a_drift_larger_than_stated_is_learned() -> None:
    assert np.median([night.fit.factor for night in sixty_nights(season)[10:]]) > 2.0
    quiet = fused_nights(straightness_steps, STEP_NIGHT - 1, stated_um=4.0 * STATED_UM)
    assert quiet[-1].fit.factor < 0.5


def identified(night: MeasuredNight, earlier: Path, out: Path, *more: str) -> dict[str, Any]:
    """Return the JSON output of `volcal identify` for the files of a night."""
    balls, artefact = out.with_suffix(".csv"), out.with_suffix(".toml")
    balls.write_text(
        ball_text(rows_of(night.seen, 0, per_station=len(np.unique(night.seen.position)))), encoding="utf-8"
    )
    artefact.write_text(artefact_text(night.bar), encoding="utf-8")
    arguments = [balls, "--machine", MACHINE_FILE, "--artefact", artefact, "--out", out, "--carried-over", earlier]
    done = CliRunner().invoke(identify, [*map(str, arguments), *more, "--json"], prog_name="volcal identify")
    document: dict[str, Any] = json.loads(done.stdout.splitlines()[0])
    return document


@pytest.fixture(scope="module")
def before_the_step(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[NightScore], Path]:
    """Return the nights before the step, and the estimate file of the last of them."""
    nights = sixty_nights(straightness_steps)[: STEP_NIGHT - 1]
    file = tmp_path_factory.mktemp("before") / "estimate.json"
    file.write_text(format_estimate(nights[-1].estimate, {}), encoding="utf-8")
    return nights, file


def test_the_command_carries_the_drift_factor_on(before_the_step: tuple[list[NightScore], Path]) -> None:
    nights, file = before_the_step
    assert parse_estimate(file.read_text(), "e.json").carried_over().drift_factor == nights[-1].estimate.drift_factor


def test_the_command_names_the_night_of_a_step(before_the_step: tuple[list[NightScore], Path], tmp_path: Path) -> None:
    _, file = before_the_step
    *_, step_night = islice(measured_nights(straightness_steps, STEP_NIGHT), STEP_NIGHT + 1)
    found = identified(step_night, file, tmp_path / "step", "--process-noise-um", str(STATED_UM))
    assert found["gates"]["night"] is False
    night = found["night"]
    assert night["fits"] is False
    assert night["probability"] < 1e-4
    assert night["drift_factor"] > 3.0 * night["drift_factor_expected"]
    report = (tmp_path / "step" / "report.html").read_text(encoding="utf-8")
    assert "The night does not fit the nights before" in report
    assert night["likeliest"] in report
    stored = parse_estimate((tmp_path / "step" / "estimate.json").read_text(), "estimate.json").carried_over()
    assert stored.drift_factor.value == pytest.approx(night["drift_factor"])


def test_the_command_accepts_a_night_without_a_step(
    before_the_step: tuple[list[NightScore], Path], tmp_path: Path
) -> None:
    def without_step(machine: Any, night: int, rng: np.random.Generator) -> Any:
        return straightness_steps(machine, min(night, STEP_NIGHT - 1), rng)

    _, file = before_the_step
    *_, calm = islice(measured_nights(without_step, STEP_NIGHT), STEP_NIGHT + 1)
    found = identified(calm, file, tmp_path / "calm", "--process-noise-um", str(STATED_UM), "--no-report")
    assert found["gates"]["night"] is True
    assert found["night"]["fits"] is True
    assert found["night"]["likeliest"] is None


def test_a_drift_that_is_not_stated_does_not_fit(
    before_the_step: tuple[list[NightScore], Path], tmp_path: Path
) -> None:
    """A season of 1 to 2 µm a night, identified from files 12 nights later as if the machine had not changed."""
    *_, later = islice(measured_nights(season, 12), 13)
    start = tmp_path / "start.json"
    estimate = sixty_nights(season)[0].estimate
    start.write_text(format_estimate(estimate, {}), encoding="utf-8")
    found = identified(later, start, tmp_path / "later", "--no-report")
    assert found["night"]["fits"] is False


EXX_DRIFT = drift("EXX", 1.5e-3)
SHORT = 20
"""Nights with a drift in one direction."""


twenty_nights = cache(lambda change, seed: fused_nights(change, SHORT, seed=seed))


@pytest.mark.parametrize(
    ("error", "per_night", "unit"), [("EBX", 0.8e-6, "µrad"), ("EXX", 1.5e-3, "µm"), ("B0Z", 0.5e-6, "µrad")]
)
def test_a_drift_in_one_direction_is_named_and_followed(error: str, per_night: float, unit: str) -> None:
    change = EXX_DRIFT if error == "EXX" else drift(error, per_night)
    nights = twenty_nights(change, 1)
    told = [night.number for night in nights if night.fit.drift is not None]
    assert told[0] <= 18
    found = nights[-1].fit.drift
    assert found is not None
    suspect = found.suspects[0]
    assert (suspect.error, suspect.unit) == (error, unit)
    true_rate = per_night * (1e6 if unit == "µrad" else 1e3)
    assert suspect.rate == pytest.approx(true_rate, abs=3.0 * suspect.standard_uncertainty)
    assert 0.0 < suspect.standard_uncertainty < 0.5 * true_rate
    assert found.nights >= 0.7 * SHORT
    assert max(night.ratio for night in nights if night.number >= told[0]) < 1.35
    assert np.mean([night.held for night in nights]) >= 0.9


@pytest.mark.parametrize("change", [still, walk_of_everything])
def test_without_a_drift_none_is_told(change: Change) -> None:
    nights = twenty_nights(change, 1)
    assert [night.number for night in nights if night.fit.drift is not None] == []
    assert np.mean([night.held for night in nights]) >= 0.9


def test_a_step_is_told_with_the_alternatives_that_the_station_cannot_exclude() -> None:
    """A wave of EYX looks like a slope at the one station that was measured."""
    nights = fused_nights(step("EYX", 12e-3, at=10), 10, seed=1)
    assert [night.number for night in nights if not night.fit.fits] == [10]
    possible = {one.jump.error: one.probability for one in nights[-1].fit.suspects}
    assert {"C0Y", "EYX"} <= set(possible)
    assert possible["EYX"] > 0.03
    assert sum(possible.values()) >= 0.95


def test_the_command_tells_a_drift(tmp_path: Path) -> None:
    *before, _ = twenty_nights(EXX_DRIFT, 1)
    *_, night = islice(measured_nights(EXX_DRIFT, SHORT, 1), SHORT + 1)
    earlier = tmp_path / "earlier.json"
    earlier.write_text(format_estimate(before[-1].estimate, {}), encoding="utf-8")
    found = identified(night, earlier, tmp_path / "drift", "--process-noise-um", str(STATED_UM))
    told = found["night"]["drift"]
    assert told["suspects"][0]["error"] == "EXX"
    assert told["false_alarm"] <= 0.01
    assert told["nights"] == pytest.approx(SHORT, abs=6.0)
    report = (tmp_path / "drift" / "report.html").read_text(encoding="utf-8")
    assert "The machine drifts in one direction: EXX by +1." in report
    stored = parse_estimate((tmp_path / "drift" / "estimate.json").read_text(), "estimate.json").carried_over()
    assert stored.trend.rates is not None
