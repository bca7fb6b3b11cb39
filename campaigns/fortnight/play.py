"""The fortnight from its first evening to its last morning."""

from __future__ import annotations

import logging
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import structlog

from benchmarks.places import memory_directory
from campaigns.fortnight.evening import Evening
from campaigns.fortnight.house import House
from campaigns.fortnight.incidents import Incidents
from campaigns.fortnight.ledger import acting_is_accepted, differing, history_of, left_over, trends_of
from campaigns.fortnight.plant import Plant
from campaigns.nights.season import Season, reach_um
from simulators.scenario import Scenario

LARGEST_RATIO = 1.5
DAMAGE = "damage"


@dataclass(frozen=True)
class Programme:
    """`evenings` in turn, each one or more names of `Incidents`, separated by commas; `changes` of the shipped
    settings; `compared`: with what only a machine of one's own can tell, and with trends, which take their nights;
    `hit`: how hard the machine is hit, in collisions of the season."""

    evenings: tuple[str, ...]
    changes: dict[str, str] = field(default_factory=dict)
    compared: bool = True
    hit: float = 1.0

    @property
    def season(self) -> Season:
        """The collision is before the slot of the evening that is named for it."""
        damaged = self.evenings.index(DAMAGE) if DAMAGE in self.evenings else len(self.evenings)
        return Season(len(self.evenings) - 1, damaged, seed=1)

    @property
    def scenario(self) -> Scenario:
        found = self.season.scenario
        ageing = found.settings.ageing
        collision = {name: self.hit * jump for name, jump in ageing.collision.items()}
        harder = ageing.model_copy(update={"collision": collision})
        return replace(found, settings=found.settings.model_copy(update={"ageing": harder}))


FORTNIGHT = Programme(
    (
        *("calibrated by hand", "timer at noon, timer", "verify", "doors open, timer", "link loss", "timer"),
        *("power failure", "timer", "abort", "timer", "timer", DAMAGE, "full calibration", "timer"),
    )
)
THIN = Programme(
    ("calibrated by hand", "timer at noon, link loss", "doors open, power failure", "abort", DAMAGE),
    {
        'position_set = "S3"': 'position_set = "S1"',
        "[verification]\nstations = [1, 4]": (
            "[verification]\nstations = [1]\nmax_remaining_fraction = 1.0\nmax_chi2 = 1e3"
        ),
        "[gates]": "[gates]\nmin_degrees_of_freedom = 1\nmax_remaining_fraction = 1.0\nmax_chi2 = 1e3",
    },
    compared=False,
    hit=6.0,
)
"""Everything in five evenings, and as little measured as it can be: what is known so badly must be hit hard."""


@dataclass
class Played:
    """`trends`: as history tells them before the damage, and at the end."""

    evenings: list[Evening]
    rows: list[dict[str, Any]] = field(default_factory=list)
    trends: dict[str, dict[str, Any]] = field(default_factory=dict)
    claims: dict[str, bool] = field(default_factory=dict)
    failed: list[str] = field(default_factory=list)
    collisions: int = 0
    wall_s: float = 0.0


def play(programme: Programme, report: Callable[[str], None], figure: Path | None = None) -> Played:
    """All of it; nothing is left over but what is handed back."""
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.ERROR))
    began = perf_counter()
    with (
        ProcessPoolExecutor(1) as pool,
        memory_directory("fortnight") as directory,
    ):
        reached = _reached(programme, pool)
        played = _Player(programme, Path(directory), report).played(figure)
        played.claims["no process is left"] = not left_over(Path(directory))
        for evening, reach in zip(played.evenings, reached, strict=True):
            evening.reach = reach.result()
    _judge(programme, played)
    played.wall_s = perf_counter() - began
    return played


def _reached(programme: Programme, pool: ProcessPoolExecutor) -> list[Future[float]]:
    """Worked out beside the nights, by a process that begins before there are threads."""
    season = programme.season
    return [pool.submit(reach_um if programme.compared else _unknown, season, n) for n in range(season.nights + 1)]


def _unknown(_: Season, __: int) -> float:
    return 0.0


class _Player:
    def __init__(self, programme: Programme, directory: Path, report: Callable[[str], None]) -> None:
        self._programme = programme
        self._season = programme.season
        self._report = report
        self._plant = Plant(programme.scenario, self._season.station)
        self._house = House(directory, self._plant.ready, programme.changes)
        self._incidents = Incidents(self._house, self._plant, compared=programme.compared)

    def played(self, figure: Path | None) -> Played:
        played = Played([])
        with self._house as house:
            for night, name in enumerate(self._programme.evenings):
                played.evenings.append(self._evening(night, name))
                if name == DAMAGE:
                    played.trends["damaged"] = trends_of(house)
                if self._programme.evenings[night + 1 : night + 2] == (DAMAGE,):
                    played.trends["before"] = trends_of(house, figure and figure.with_stem(f"{figure.stem}-before"))
            played.claims["the service ends well"] = house.stop() == 0
            played.rows = history_of(house)
            played.trends["end"] = trends_of(house, figure)
            played.failed = differing(house, played.evenings, played.rows)
            played.claims["history as it should be"] = not played.failed
        self._plant.switch_off()
        played.collisions = self._plant.collisions
        return played

    def _evening(self, night: int, name: str) -> Evening:
        began = perf_counter()
        evening = Evening(night, name, self._season.station(night))
        if night:
            self._plant.becomes(night)
        evening.true_before = self._plant.true_um
        if not night:
            self._incidents.prepare(evening)
        for incident in name.split(", "):
            self._incidents.by_name[incident](evening)
        evening.true_after, evening.active_bank = self._plant.true_um, self._plant.active_bank
        evening.claims["the last accepted table acts"] = acting_is_accepted(self._house, self._plant)
        evening.wall_s = perf_counter() - began
        self._report(line(evening))
        return evening


def _judge(programme: Programme, played: Played) -> None:
    """What only the simulator knows, and everything that has failed."""
    played.claims["no collision"] = played.collisions == 0
    if programme.compared:
        bound = [e.ratio <= LARGEST_RATIO for e in played.evenings if e.incident != DAMAGE]
        played.claims["true error within its bound"] = all(bound)
        played.claims |= trend_claims(played)
    played.failed += [name for evening in played.evenings for name in evening.failed]
    played.failed += [name for name, held in played.claims.items() if not held]


def trend_claims(played: Played) -> dict[str, bool]:
    """What history warns of, and when."""
    before, damaged, end = (played.trends[name] for name in ("before", "damaged", "end"))
    acting = {trend["name"]: trend for trend in before["trends"]}.get("ve_acting", {})
    return {
        "control limits before the damage": acting.get("control_limits") is not None,
        "no tolerance is reached before the damage": not _limits(before),
        "the damage reaches a tolerance": _limits(damaged) == ["held_out"],
        "no tolerance is reached at the end": not _limits(end),
    }


def _limits(trends: dict[str, Any]) -> list[str]:
    """Series that have reached their tolerance."""
    return [alarm["series"] for alarm in trends["alarms"] if alarm["kind"] == "limit"]


def line(evening: Evening) -> str:
    return (
        f"{evening.night + 1:2d} {evening.incident:25s} station {evening.station}: exit codes {evening.asked}, true "
        f"{evening.true_before:5.2f} -> {evening.true_after:5.2f} µm, bank {evening.active_bank}, "
        f"{evening.wall_s:.1f} s {evening.told or ''} {' '.join(evening.failed)}"
    )
