"""The probe check and the qualification as plans, on a ball in plain arithmetic."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import count
from pathlib import Path

import numpy as np
import pytest
from touched_ball import TouchedBall, ended

from agent.errors import MeasurementFault
from agent.execution import steps as s
from agent.planning.job import Job
from agent.planning.job_preparation import prepare_job
from agent.probing.ball import LostBall, measure_ball
from agent.probing.latch_delay import measure_latch_delay
from agent.probing.lost_ball import lost_ball_fault
from agent.probing.preparation import PreparationResult, prepare_probe
from agent.probing.probe_check import ProbeCheck, check_repeatability
from agent.probing.qualification import qualify_stylus
from agent.probing.run_plan import MeasuringOrder
from agent.settings.load import load_settings
from drivers.errors import ConfigurationError
from twin.artefact.position_set import Position

CONFIG = Path(__file__).resolve().parents[3] / "config" / "case-study.toml"
JOB: Job = prepare_job(load_settings(CONFIG), CONFIG.parent)
PROBING = JOB.rules.probing
CENTRE = np.array([1500.0, 700.0, 400.0])
CHECK = ProbeCheck(5, 2e-3)


def scattered(depths_um: list[float]) -> TouchedBall:
    """Trips one after another so much late."""
    numbers = count()
    return TouchedBall(CENTRE, PROBING.contact_mm, lambda *_: 1e-3 * depths_um[next(numbers) % len(depths_um)])


def decisions(player: TouchedBall) -> list[dict[str, object]]:
    return [dict(x.payload) for x in player.steps if isinstance(x, s.Record) and x.kind == "decision"]


def test_two_sigma_of_five_touches_is_that_of_hand_arithmetic() -> None:
    """Depths 0, ±1, ±0.5 µm: s² = 2.5/4."""
    player = scattered([0.0, 1.0, -1.0, 0.5, -0.5])
    result = player.run(check_repeatability("c", CENTRE, PROBING, CHECK))
    assert result.two_sigma_um == pytest.approx(2.0 * math.sqrt(2.5 / 4.0), abs=1e-6)
    assert result.verdict == "within"
    low, high = result.interval_um
    assert (low / result.two_sigma_um, high / result.two_sigma_um) == pytest.approx((0.599, 2.874), abs=1e-3)
    assert decisions(player)[0]["touches"] == 5
    assert decisions(player)[0]["depths_um"] == pytest.approx(
        [-1e3 * PROBING.contact_mm + depth for depth in (0.0, 1.0, -1.0, 0.5, -0.5)]
    )


def test_a_probe_near_its_limit_is_touched_as_often_again_and_let_pass_with_the_doubt_said() -> None:
    player = scattered([1.2, -1.2, 1.2, -1.2, 1.2])
    result = player.run(check_repeatability("c", CENTRE, PROBING, CHECK))
    assert len(player.touched) == result.touches == 10
    assert result.verdict == "above, but not surely beyond"
    assert player.events[0]["then"] == "5 touches more"
    assert "95% confidence" in result.text


def test_a_probe_surely_beyond_its_limit_stops_the_run_with_the_figure() -> None:
    player = scattered([6.0, -6.0, 5.0, -7.0, 6.0])
    _, end = ended(player, check_repeatability("c", CENTRE, PROBING, CHECK))
    assert "does not repeat: 2σ 12." in end
    assert decisions(player)[0]["verdict"] == "beyond"


def test_a_touch_that_misses_the_ball_just_found_stops_the_run() -> None:
    player = TouchedBall(CENTRE + np.array([0.0, 40.0, 0.0]), PROBING.contact_mm, lambda *_: 0.0)
    _, end = ended(player, check_repeatability("c", CENTRE, PROBING, CHECK))
    assert "missed the ball" in end


def test_qualification_finds_the_effective_radius_and_fixes_it_where_that_is_better() -> None:
    rules = JOB.preparation.qualification
    assert rules is not None
    player = TouchedBall(CENTRE, PROBING.contact_mm, lambda *_: 8e-3)
    found = player.run(qualify_stylus("q", CENTRE, PROBING, rules))
    assert found.stylus.radius_mm == pytest.approx(PROBING.contact_mm - 8e-3, abs=1e-9)
    assert found.stylus.fixed
    assert found.trace_fixed_um2 < found.trace_free_um2
    assert len(player.touched) == 25
    assert "effective radius 15.4920 mm" in found.text
    # Balls that differ by 3 µm in radius: a radius that belongs to one of them says little of another.
    uneven = replace(rules, spread_mm=3e-3)
    again = TouchedBall(CENTRE, PROBING.contact_mm, lambda *_: 8e-3).run(qualify_stylus("q", CENTRE, PROBING, uneven))
    assert not again.stylus.fixed


def test_a_datum_ball_that_is_no_ball_stops_the_run() -> None:
    rules = JOB.preparation.qualification
    assert rules is not None
    player = TouchedBall(CENTRE, PROBING.contact_mm, lambda way, *_: -0.05 if way[0] > 0.8 else 0.0)
    _, end = ended(player, qualify_stylus("q", CENTRE, PROBING, rules))
    assert "could not be measured: form" in end


def prepared_at(
    *positions: Position, job: Job = JOB, standing_at: int | None = 1
) -> tuple[TouchedBall, PreparationResult]:
    """On the first ball of the first position named."""
    centre = job.layout.nominal(positions[-1])[0]
    player = TouchedBall(centre, PROBING.contact_mm, lambda *_: 8e-3)
    order = MeasuringOrder("measure", positions, standing_at)
    return player, player.run(prepare_probe(order, job.layout, job.rules, job.preparation))


def test_preparation_is_done_at_the_first_ball_of_the_first_position_and_ends_at_the_retreat_plane() -> None:
    player, prepared = prepared_at(Position(1, 45.0, 0.0))
    assert prepared.standing_at == 1
    assert prepared.rules.probing.stylus is not None
    assert prepared.rules.probing.expected_radius_mm == pytest.approx(PROBING.contact_mm - 8e-3)
    keys = [step.key for step in player.steps]
    assert len(keys) == len(set(keys))
    assert all(key.startswith("probe/station-1/az45-el0/") for key in keys)
    moves = [step for step in player.steps if isinstance(step, s.MoveTo)]
    assert moves[-1].target_mm[1] == JOB.rules.retreat.retreat_mm
    assert all(move.guarded for move in moves)


def test_where_the_first_position_has_no_ball_free_all_around_the_next_one_serves() -> None:
    player, prepared = prepared_at(Position(1, 90.0, 45.0), Position(2, 45.0, 0.0))
    assert prepared.standing_at == 2
    assert [type(step) for step in player.steps].count(s.AskOperator) == 1
    assert player.steps[-1].key.startswith("probe/station-2/az45-el0/")


def test_no_ball_free_all_around_is_said() -> None:
    _, end = ended(
        TouchedBall(CENTRE, 1.0, lambda *_: 0.0),
        prepare_probe(MeasuringOrder("m", (Position(1, 90.0, 45.0),), 1), JOB.layout, JOB.rules, JOB.preparation),
    )
    assert "cannot be qualified: no ball" in end


def test_what_is_switched_off_moves_nothing() -> None:
    off = replace(JOB.preparation, check=None, qualification=None, reversal=None)
    player = TouchedBall(CENTRE, 1.0, lambda *_: 0.0)
    prepared = player.run(prepare_probe(MeasuringOrder("m", (), 1), JOB.layout, JOB.rules, off))
    assert player.steps == []
    assert prepared.rules is JOB.rules


def test_a_datum_ball_that_the_artefact_has_not_is_refused() -> None:
    settings = load_settings(CONFIG)
    chosen = settings.model_copy(update={"qualification": settings.qualification.model_copy(update={"ball": 11})})
    with pytest.raises(ConfigurationError, match="no ball 11"):
        prepare_job(chosen, CONFIG.parent)


def delayed(delay_s: float, drift_mm: float = 0.0) -> TouchedBall:
    """A latch that is late by a time, and a ball that moves away by a drift from touch to touch."""
    numbers = count()
    return TouchedBall(CENTRE, PROBING.contact_mm, lambda _, feed, __: 8e-3 + feed * delay_s + drift_mm * next(numbers))


def test_the_delay_of_the_latch_is_the_slope_of_the_depth_over_the_feed_and_free_of_a_linear_drift() -> None:
    """2 ms at 300 and at 75 mm/min: 10 and 2.5 µm deeper than the trip."""
    player = delayed(2e-3, drift_mm=5e-4)
    found = player.run(measure_latch_delay("l", CENTRE, PROBING, 4))
    assert found.delay_ms == pytest.approx(2.0, abs=1e-6)
    assert found.lag_um == pytest.approx(10.0, abs=1e-5)
    assert found.feeds_mm_per_min == pytest.approx((75.0, 300.0))
    assert (
        sorted(step.feed_mm_per_s for step in player.steps if isinstance(step, s.TouchTowards))
        == [1.25] * 4 + [5.0] * 4
    )
    # four touches at each feed: 1.2 µm of one touch √(2 / 4) over 3.75 mm/s
    assert found.sigma_ms == pytest.approx(max(1.2, 1e3 * drift_scatter(5e-4)) * math.sqrt(0.5) / 3.75, rel=1e-6)
    (warning,) = found.warnings
    assert "latched 2.0 ms after the trip; at 300 mm/min the axes travel 10.0 µm" in warning
    assert player.events[-1]["reason"] == warning
    (decision,) = decisions(player)
    assert decision["delay_ms"] == pytest.approx(2.0, abs=1e-6)
    assert [len(depths) for depths in decision["depths_um"]] == [4, 4]  # type: ignore[attr-defined]


def drift_scatter(drift_mm: float) -> float:
    """Standard deviation of touches 0, 3, 4, 7 (or 1, 2, 5, 6) of a linear drift, pooled, in mm."""
    slow, fast = np.array([0, 3, 4, 7]), np.array([1, 2, 5, 6])
    return drift_mm * math.sqrt(0.5 * (np.var(slow, ddof=1) + np.var(fast, ddof=1)))


@pytest.mark.parametrize(("delay_ms", "warned"), [(0.0, False), (0.9, False), (1.5, True), (-1.5, True)])
def test_a_warning_is_given_only_for_a_lag_that_is_surely_beyond_its_limit(delay_ms: float, warned: bool) -> None:
    """Five touches each: 2σ of the lag is 1.2 µm √(2/5) 2 · 5/3.75 = 2.0 µm: beyond the limit of 5 µm from 1.4 ms."""
    found = delayed(1e-3 * delay_ms).run(measure_latch_delay("l", CENTRE, PROBING, 5))
    assert bool(found.warnings) == warned
    if delay_ms < 0.0:
        assert "no delay of the latch" in found.warnings[0]


def lost_datum(player: TouchedBall) -> MeasurementFault:
    """Measure the ball of `player`, which is expected to fail, and return the fault that the run states."""

    def plan() -> s.Plan[MeasurementFault]:
        found = yield from measure_ball("b", CENTRE, PROBING, PROBING.locating_search)
        assert isinstance(found, LostBall)
        return (yield from lost_ball_fault("b", "the ball for the probe check", found, PROBING))

    fault = player.run(plan())
    assert isinstance(fault, MeasurementFault)
    return fault


def test_a_latch_that_is_a_cycle_late_is_named_where_the_ball_appears_too_small() -> None:
    """40 ms at 300 mm/min: 200 µm deeper than the trip."""
    fault = lost_datum(delayed(40e-3))
    assert "appears too small: radius is off by -2" in fault.message
    assert "latches the axis positions 40.0 ms after the trip, and the axes travel 200 µm meanwhile" in fault.message
    assert "fast input" in fault.hint


def test_a_wrong_diameter_is_not_blamed_on_the_latch() -> None:
    fault = lost_datum(TouchedBall(CENTRE, PROBING.contact_mm - 0.2, lambda *_: 0.0))
    assert "equally so at a lower feed" in fault.message
    assert fault.hint.startswith("check the ball diameter")


def test_a_ball_that_is_not_there_is_not_touched_again() -> None:
    fault = lost_datum(TouchedBall(CENTRE, PROBING.contact_mm, lambda *_: None))
    assert fault.message.startswith("the ball for the probe check was not found where it was expected: touch 0 met")


def test_a_touch_at_the_lower_feed_that_meets_nothing_stops_the_check() -> None:
    player = TouchedBall(CENTRE, PROBING.contact_mm, lambda _, feed, __: None if feed < 5.0 else 0.0)
    _, end = ended(player, measure_latch_delay("l", CENTRE, PROBING, 5))
    assert "missed the ball" in end
