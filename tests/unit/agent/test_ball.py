"""A ball by touches: gates that trip and what is done about them, misses, two stages, what five touches cannot show."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from touched_ball import TouchedBall, ended

from agent.execution import steps as s
from agent.probing.ball import FittedBall, LostBall, doubtful_touches, measure_ball, pole_error_mm
from agent.probing.probing_parameters import BallLimits, FastTouch, ProbingParameters, Search, Stylus
from drivers.errors import CommandRejected
from twin.artefact.sphere_fit import fit_sphere
from twin.artefact.touch_pattern import approach_directions, known_radius_covariance

AXIS = np.array([0.0, 1.0, 0.0])
CENTRE = np.array([1500.0, 700.0, 400.0])
PROBING = ProbingParameters(
    directions=approach_directions(5, AXIS),
    stylus_axis=AXIS,
    ball_radius_mm=12.5,
    tip_radius_mm=3.0,
    narrow_search=Search(3.0, 3.0),
    wide_search=Search(8.0, 8.0),
    feed_mm_per_s=5.0,
    retract_mm=45.0,
    touch_sigma_mm=1.0e-3,
    limits=BallLimits(0.020, 0.010, 0.006, 0.010),
    recentre_mm=0.3,
    repeats=2,
    stop_on_failure=False,
)


def probing(touches: int = 5, **changes: Any) -> ProbingParameters:
    return replace(PROBING, directions=approach_directions(touches, AXIS), **changes)


def clean(*_: object) -> float:
    return 0.0


def first_time(key_end: str, wrong_mm: float):
    """One touch is wrong the first time it is made."""

    def late(_way: np.ndarray, _feed: float, key: str) -> float:
        return wrong_mm if key == key_end else 0.0

    return late


def gates(player: TouchedBall) -> list[tuple[str, str]]:
    return [(event.get("gate", ""), event["then"]) for event in player.events]


@pytest.mark.parametrize("touches", [5, 9, 13, 25])
@pytest.mark.parametrize("fast_touch", [None, FastTouch(20.0, 1.0)])
def test_every_pattern_finds_the_centre_in_one_stage_and_in_two(touches: int, fast_touch: FastTouch | None) -> None:
    player = TouchedBall(CENTRE, PROBING.contact_mm, clean)
    found = player.run(
        measure_ball(
            "b", CENTRE + np.array([0.1, -0.1, 0.05]), probing(touches, fast_touch=fast_touch), PROBING.narrow_search
        )
    )
    assert isinstance(found, FittedBall)
    assert found.centre_mm == pytest.approx(CENTRE, abs=1e-9)
    assert found.touches == len(player.touched) == touches * (1 if fast_touch is None else 2)
    assert player.events == []


def test_in_two_stages_only_the_slow_touch_counts() -> None:
    """A signal that is late by 2 ms moves a fast touch by 40 µm and a slow one by 1.0 µm."""
    delay_s, slow, fast = 2e-3, 0.5, 20.0
    player = TouchedBall(CENTRE, PROBING.contact_mm, lambda _way, feed, _key: feed * delay_s)
    two = probing(fast_touch=FastTouch(fast, 1.0), feed_mm_per_s=slow)
    found = player.run(measure_ball("b", CENTRE, two, PROBING.narrow_search))
    assert found.radius_mm == pytest.approx(PROBING.contact_mm - slow * delay_s, abs=1e-9)
    touch = [step for step in player.steps if step.key.startswith("b/touch-1")]
    assert [step.key for step in touch] == [
        "b/touch-1/above", "b/touch-1/start", "b/touch-1/find", "b/touch-1/back-off", "b/touch-1", "b/touch-1/back",
    ]  # fmt: skip
    feeds = [step.feed_mm_per_s for step in touch if isinstance(step, s.TouchTowards)]
    assert feeds == [fast, slow]


def test_a_false_trip_goes_away_by_a_clean_up_touch() -> None:
    player = TouchedBall(CENTRE, PROBING.contact_mm, first_time("b/touch-7", -0.030))
    found = player.run(measure_ball("b", CENTRE, probing(9), PROBING.narrow_search))
    assert found.centre_mm == pytest.approx(CENTRE, abs=1e-9)
    assert gates(player) == [("form", "clean-up of touch 7")]
    assert player.events[0]["ball"] == "b"
    assert player.events[0]["figure_um"] > player.events[0]["limit_um"] == 10.0
    assert player.touched[9:] == ["b/clean-up/touch-7"]
    assert found.touches == 10


def test_on_five_points_all_of_the_equator_is_doubted_since_nothing_tells_them_apart() -> None:
    player = TouchedBall(CENTRE, PROBING.contact_mm, first_time("b/touch-3", -0.050))
    found = player.run(measure_ball("b", CENTRE, probing(), PROBING.narrow_search))
    assert found.centre_mm == pytest.approx(CENTRE, abs=1e-9)
    assert player.touched[5:] == [f"b/clean-up/touch-{index}" for index in (1, 2, 3, 4)]


def test_dirt_that_stays_leads_to_repeats_and_then_to_the_policy() -> None:
    def dirty(way: np.ndarray, _feed: float, _key: str) -> float:
        return -0.040 if np.allclose(way, probing(9).directions[7], atol=0.05) else 0.0

    player = TouchedBall(CENTRE, PROBING.contact_mm, dirty)
    lost = player.run(measure_ball("b", CENTRE, probing(9), PROBING.narrow_search))
    assert isinstance(lost, LostBall)
    assert "form" in lost.reason
    assert [then for _, then in gates(player)] == [
        "clean-up of touch 7", "repeat the ball", "clean-up of touch 7", "repeat the ball", "clean-up of touch 7",
        "skip the ball",
    ]  # fmt: skip
    assert lost.touches == len(player.touched) == 3 * 10

    stopping = TouchedBall(CENTRE, PROBING.contact_mm, dirty)
    _, end = ended(
        stopping, measure_ball("b", CENTRE, probing(9, stop_on_failure=True, repeats=0), PROBING.narrow_search)
    )
    assert "could not be measured: form" in end
    assert gates(stopping)[-1] == ("form", "stop")


@pytest.mark.parametrize(
    ("gate", "late_mm", "limits"),
    [
        ("radius", lambda _way: -0.021, PROBING.limits),
        ("touch", lambda way: 0.004 if way[0] > 0.5 and way[2] > 0.5 else 0.0, BallLimits(0.02, 0.01, 5e-4, 0.01)),
        ("pole", lambda way: 0.009 if way[1] > 0.99 else 0.0, BallLimits(0.02, 0.02, 0.02, 0.008)),
    ],
)
def test_each_gate_names_its_figure(gate: str, late_mm, limits: BallLimits) -> None:
    player = TouchedBall(CENTRE, PROBING.contact_mm, lambda way, *_: late_mm(way))
    player.run(measure_ball("b", CENTRE, probing(13, limits=limits), PROBING.narrow_search))
    event = player.events[0]
    assert (event["gate"], event["ball"]) == (gate, "b")
    assert abs(event["figure_um"]) > event["limit_um"]


def test_radius_is_held_against_the_qualified_one() -> None:
    """8 µm of pretravel and a stylus 15 µm too thick: 23 µm off the drawings, none off what was qualified."""
    off_mm = 0.023
    player = TouchedBall(CENTRE, PROBING.contact_mm, lambda *_: -off_mm)
    stylus = Stylus(PROBING.contact_mm + off_mm, 3e-4, fixed=False)
    assert isinstance(
        player.run(measure_ball("b", CENTRE, probing().qualified(stylus), PROBING.narrow_search)), FittedBall
    )
    player = TouchedBall(CENTRE, PROBING.contact_mm, lambda *_: -off_mm)
    assert isinstance(player.run(measure_ball("b", CENTRE, probing(), PROBING.narrow_search)), LostBall)


def test_pole_against_equator_is_the_distance_from_the_sphere_through_the_rest() -> None:
    rng = np.random.default_rng(8)
    for touches in (9, 13, 25):
        directions = approach_directions(touches, AXIS)
        points = -directions * (15.5 + rng.normal(0.0, 2e-3, touches))[:, None]
        fit, rest = fit_sphere(points, 1e-3), fit_sphere(points[1:], 1e-3)
        expected = np.linalg.norm(points[0] - rest.centre) - rest.radius
        assert pole_error_mm(fit, probing(touches)) == pytest.approx(expected, rel=5e-3)


def test_five_points_say_nothing_of_the_pole() -> None:
    late = TouchedBall(CENTRE, PROBING.contact_mm, lambda way, *_: 0.1 if way[1] > 0.99 else 0.0)
    found = late.run(measure_ball("b", CENTRE, probing(), PROBING.narrow_search))
    assert isinstance(found, FittedBall)
    assert found.centre_mm[1] - CENTRE[1] == pytest.approx(0.1, rel=0.01)
    assert late.events == []
    oval = 15.5 + 1e-3 * np.array([0.0, 1.0, -1.0, 1.0, -1.0])
    fit = fit_sphere(-probing().directions * oval[:, None], 1e-3)
    assert pole_error_mm(fit, probing()) is None
    assert doubtful_touches(fit, probing()) == (1, 2, 3, 4)


class KnockedBall(TouchedBall):
    """Ball that is displaced by `knock_mm` just before the touch with the key `at`.

    `rapid_hits` are the keys of rapid moves that end in the ball or pass through it. A move at a feed stops there.
    """

    def __init__(self, at: str, knock_mm: np.ndarray) -> None:
        super().__init__(CENTRE, PROBING.contact_mm, clean)
        self.knocked_at = at
        self.knock_mm = knock_mm
        self.rapid_hits: list[str] = []

    def to(self, step: s.Step) -> Any:
        if step.key == self.knocked_at:
            self.centre_mm = CENTRE + self.knock_mm
        if isinstance(step, s.MoveTo) and self._passes_through(self.at, np.array(step.target_mm)):
            if step.feed_mm_per_s is not None:
                raise CommandRejected("the probe tripped", hint="", device="cnc")
            self.rapid_hits.append(step.key)
        return super().to(step)

    def _passes_through(self, begin: np.ndarray, end: np.ndarray) -> bool:
        way = end - begin
        square = float(way @ way)
        part = 0.0 if square == 0.0 else min(max(float((self.centre_mm - begin) @ way) / square, 0.0), 1.0)
        return float(np.linalg.norm(begin + part * way - self.centre_mm)) < self.contact_mm - 1e-6


def drawn_knock_mm(rng: np.random.Generator) -> np.ndarray:
    """Knock of any direction, by 0.3 to 12 mm."""
    direction = rng.normal(size=3)
    return np.asarray(direction / np.linalg.norm(direction) * rng.uniform(0.3, 12.0))


@pytest.mark.parametrize("touches", [3, 5, 9])
def test_a_ball_that_is_knocked_between_its_touches_is_never_hit_at_rapid_when_it_is_repeated(touches: int) -> None:
    """A move of the pattern in which the ball is knocked may hit it, since nothing has shown the knock. What is
    repeated afterwards must not: not for any direction and size of the knock."""
    rng = np.random.default_rng(touches)
    guarded = probing(touches, guarded_feed_mm_per_s=20.0)
    if touches == 3:
        guarded = guarded.qualified(Stylus(PROBING.contact_mm, 3e-4, fixed=True))
    repeated = 0
    for _ in range(500):
        knock_mm = drawn_knock_mm(rng)
        player = KnockedBall(f"b/touch-{rng.integers(1, touches)}", knock_mm)
        with suppress(CommandRejected):
            player.run(measure_ball("b", CENTRE, guarded, PROBING.narrow_search))
        if any(key.startswith("b/touch-") for key in player.rapid_hits):
            continue
        repeated += any(key.startswith(("b/repeat-", "b/clean-up")) for key in player.touched)
        assert player.rapid_hits == [], (player.knocked_at, knock_mm)
    assert repeated > 150


def test_a_ball_that_is_knocked_while_it_is_located_is_seldom_hit_at_rapid_afterwards() -> None:
    """The locating touches then lie on no sphere of the ball. They show nothing of a knock that moves the ball along
    its surface at the touches that follow: those few balls may be hit."""
    rng = np.random.default_rng(1)
    guarded = probing(guarded_feed_mm_per_s=20.0)
    hit = 0
    for _ in range(300):
        knock_mm = drawn_knock_mm(rng)
        player = KnockedBall(f"b/locate/touch-{rng.integers(1, 5)}", knock_mm)
        with suppress(CommandRejected):
            player.run(measure_ball("b", CENTRE, guarded, guarded.locating_search))
        hit += any(not key.startswith("b/locate/") for key in player.rapid_hits)
    assert hit < 10  # 83 if the tip always moves at rapid traverse once the ball has been located


def test_touches_that_still_contradict_each_other_repeat_the_ball_at_the_feed_for_an_unknown_place() -> None:
    wrong = ("b/touch-4", "b/clean-up/touch-4")
    player = TouchedBall(CENTRE, PROBING.contact_mm, lambda _way, _feed, key: 2.0 if key in wrong else 0.0)
    found = player.run(measure_ball("b", CENTRE, probing(guarded_feed_mm_per_s=20.0), PROBING.narrow_search))
    assert isinstance(found, FittedBall)
    assert found.centre_mm == pytest.approx(CENTRE, abs=1e-9)
    assert [event["then"] for event in player.events[:2]] == ["clean-up of touch 4", "repeat the ball"]
    assert "contradict each other" in player.events[1]["reason"]
    assert feeds_beside(player, "b/clean-up") == feeds_beside(player, "b/repeat-1") == {20.0}


def test_three_touches_that_find_the_ball_elsewhere_are_repeated_at_the_feed_for_an_unknown_place() -> None:
    """They always lie on a sphere of the qualified radius: a ball that moves between them contradicts nothing."""
    known = probing(3, guarded_feed_mm_per_s=20.0).qualified(Stylus(PROBING.contact_mm, 3e-4, fixed=True))
    far_mm = np.array([0.0, 0.0, 0.5])
    player = TouchedBall(CENTRE + far_mm, PROBING.contact_mm, clean)
    found = player.run(measure_ball("b", CENTRE, known, PROBING.narrow_search))
    assert found.centre_mm == pytest.approx(CENTRE + far_mm, abs=1e-9)
    assert feeds_beside(player, "b/repeat-1") == {20.0}


def test_five_touches_that_agree_where_the_ball_is_are_repeated_at_rapid_traverse() -> None:
    player = TouchedBall(CENTRE + np.array([0.0, 0.0, 0.5]), PROBING.contact_mm, clean)
    found = player.run(measure_ball("b", CENTRE, probing(guarded_feed_mm_per_s=20.0), PROBING.narrow_search))
    assert isinstance(found, FittedBall)
    assert feeds_beside(player, "b/repeat-1") == {None}


@pytest.mark.parametrize("early_mm", [1.0, 2.5])
def test_a_false_trip_far_from_the_ball_goes_away_by_a_clean_up_touch_too(early_mm: float) -> None:
    """One touch far off its sphere also moves the centre of the fit far away: no reason to repeat the whole ball."""
    player = TouchedBall(CENTRE, PROBING.contact_mm, first_time("b/touch-7", -early_mm))
    found = player.run(measure_ball("b", CENTRE, probing(9, repeats=0), PROBING.narrow_search))
    assert isinstance(found, FittedBall)
    assert found.centre_mm == pytest.approx(CENTRE, abs=1e-9)
    assert [then for _, then in gates(player)] == ["clean-up of touch 7"]


def feeds_beside(player: TouchedBall, prefix: str) -> set[float | None]:
    """Feeds of the moves towards the touches whose keys begin with `prefix`."""
    moves = [step for step in player.steps if isinstance(step, s.MoveTo) and step.key.startswith(f"{prefix}/")]
    return {step.feed_mm_per_s for step in moves if not step.key.endswith(("/off", "/back"))}


def test_a_miss_is_searched_wider_once() -> None:
    """The ball stands 5 mm farther in than the narrow search goes; from there it is measured again."""
    player = TouchedBall(CENTRE + np.array([0.0, 5.0, 0.0]), PROBING.contact_mm, clean)
    found = player.run(measure_ball("b", CENTRE, probing(), PROBING.narrow_search))
    assert isinstance(found, FittedBall)
    assert found.centre_mm == pytest.approx(CENTRE + np.array([0.0, 5.0, 0.0]), abs=1e-6)
    assert [event["then"] for event in player.events] == ["search wider", "repeat the ball"]


@pytest.mark.parametrize(("stop", "then"), [(False, "skip the ball"), (True, "stop")])
def test_a_miss_of_the_wide_search_ends_it_by_policy(stop: bool, then: str) -> None:
    player = TouchedBall(CENTRE + np.array([0.0, 50.0, 0.0]), PROBING.contact_mm, clean)
    lost, end = ended(player, measure_ball("b", CENTRE, probing(stop_on_failure=stop), PROBING.narrow_search))
    assert [event["then"] for event in player.events] == ["search wider", then]
    assert player.touched == ["b/touch-0", "b/repeat-1/touch-0"]
    assert end == "done" if lost else "met nothing" in end


def test_the_search_never_goes_beyond_its_bounds() -> None:
    player = TouchedBall(CENTRE + np.array([0.0, 50.0, 0.0]), PROBING.contact_mm, clean)
    player.run(measure_ball("b", CENTRE, probing(), PROBING.narrow_search))
    depths = [step.target_mm[1] - CENTRE[1] for step in player.steps if isinstance(step, s.TouchTowards)]
    assert depths == pytest.approx([-15.5 + 3.0, -15.5 + 8.0])


@pytest.mark.parametrize("touches", [5, 9, 13, 25])
def test_a_fixed_radius_scatters_as_its_covariance_says(touches: int) -> None:
    """Balls of different radius, touch noise on each: plain sample covariance against the stated one."""
    rng = np.random.default_rng(touches)
    sigma, radius_sigma = 1.0e-3, 0.6e-3
    stylus = Stylus(PROBING.contact_mm, radius_sigma, fixed=True)
    known = probing(touches, limits=BallLimits(1.0, 1.0, 1.0, 1.0)).qualified(stylus)
    centres, stated = [], np.zeros((3, 3))
    for _ in range(600):
        player = TouchedBall(
            CENTRE, PROBING.contact_mm + rng.normal(0.0, radius_sigma), lambda *_: rng.normal(0.0, sigma)
        )
        found = player.run(measure_ball("b", CENTRE, known, PROBING.narrow_search))
        centres.append(found.centre_mm - CENTRE)
        stated = found.covariance_mm2
    assert np.cov(np.array(centres).T) == pytest.approx(stated, rel=0.2, abs=1.2e-7)
    assert stated == pytest.approx(known_radius_covariance(known.directions, sigma, radius_sigma), rel=1e-2, abs=1e-10)
