"""Execution of the whole fortnight, from its first evening to its last morning."""

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
from campaigns.fortnight.incidents import Incidents
from campaigns.fortnight.ledger import (
    active_table_is_accepted,
    leftover_processes,
    mismatched_rows,
    read_history,
    read_trends,
)
from campaigns.fortnight.plant import FortnightPlant
from campaigns.fortnight.service_process import ServiceHost
from campaigns.nights.season import Season, full_calibration_vce_um
from simulators.scenario import Scenario

LARGEST_RATIO = 1.5
DAMAGE = "damage"


@dataclass(frozen=True)
class Programme:
    """Programme of a fortnight.

    Each item of `evenings` contains one or more names of incidents from `Incidents`, separated by commas. `changes`
    maps texts of the shipped settings to the texts that replace them. `collision_scale` is the size of the collision
    relative to the collision that the nights trial (`campaigns.nights`) defines.

    If `compared` is True, the fortnight includes additional checks, which take additional time. The true errors are
    compared with the errors that full calibrations would leave, the trends in the history are checked, and an
    interrupted night is compared with the same night on a duplicate machine without interruption.
    """

    evenings: tuple[str, ...]
    changes: dict[str, str] = field(default_factory=dict)
    compared: bool = True
    collision_scale: float = 1.0

    @property
    def season(self) -> Season:
        """Season of this fortnight: the number of nights and the night of the collision.

        The collision happens before the calibration of the evening whose incident is the collision (`DAMAGE`).
        """
        damaged = self.evenings.index(DAMAGE) if DAMAGE in self.evenings else len(self.evenings)
        return Season(len(self.evenings) - 1, damaged, seed=1)

    @property
    def scenario(self) -> Scenario:
        found = self.season.scenario
        ageing = found.settings.ageing
        collision = {name: self.collision_scale * jump for name, jump in ageing.collision.items()}
        harder = ageing.model_copy(update={"collision": collision})
        return replace(found, settings=found.settings.model_copy(update={"ageing": harder}))


HELD_OUT = "positions_deg = [[30.0, 30.0], [-30.0, -30.0]]"
"""Held-out orientations to which the tolerance of the held-out balls in the service's settings applies."""

FORTNIGHT = Programme(
    (
        *("calibrated by hand", "timer at noon, timer", "verify", "doors open, timer", "link loss", "timer"),
        *("power failure", "timer", "abort", "timer", "timer", DAMAGE, "full calibration", "timer"),
    ),
    {"[verification]\n": f"[verification]\n{HELD_OUT}\n"},
)
SHORT = Programme(
    ("calibrated by hand", "timer at noon, link loss", "doors open, power failure", "abort", DAMAGE),
    {
        "[verification]\nstations = [1, 4]": f"[verification]\n{HELD_OUT}\nstations = [1]\nmax_chi2 = 1e3",
        'position_set = "S3"': 'position_set = "S3"\nstations = [1, 4]',
        "[timing]": "[gates]\nmin_degrees_of_freedom = 1\nmax_unmeasured_fraction = 10.0\nmax_chi2 = 1e3\n\n[timing]",
    },
    compared=False,
    collision_scale=6.0,
)
"""Programme with all incidents in five evenings and as few measurements as possible.

So few measurements give an uncertain estimate, so the collision must be large to be detected.
"""


@dataclass
class FortnightResult:
    """Result of a fortnight.

    `trends` contains the trends that the run history reports at three times: before the machine's collision, after it,
    and at the end.
    """

    evenings: list[Evening]
    rows: list[dict[str, Any]] = field(default_factory=list)
    trends: dict[str, dict[str, Any]] = field(default_factory=dict)
    claims: dict[str, bool] = field(default_factory=dict)
    failed: list[str] = field(default_factory=list)
    collisions: int = 0
    wall_s: float = 0.0


def run_fortnight(programme: Programme, report: Callable[[str], None], figure: Path | None = None) -> FortnightResult:
    """Run the whole fortnight and return its result. All its processes have then ended, and its files are deleted."""
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.ERROR))
    began = perf_counter()
    with (
        ProcessPoolExecutor(1) as pool,
        memory_directory("fortnight") as directory,
    ):
        reached = _full_calibration_errors(programme, pool)
        played = _FortnightRunner(programme, Path(directory), report).run(figure)
        played.claims["no process is left"] = not leftover_processes(Path(directory))
        for evening, reach in zip(played.evenings, reached, strict=True):
            evening.reach = reach.result()
    _judge(programme, played)
    played.wall_s = perf_counter() - began
    return played


def _full_calibration_errors(programme: Programme, pool: ProcessPoolExecutor) -> list[Future[float]]:
    """Compute the true error after a full calibration for each night, in a separate process.

    That process must be started before the present process has threads.
    """
    season = programme.season
    error = full_calibration_vce_um if programme.compared else _unknown
    return [pool.submit(error, season, night) for night in range(season.nights + 1)]


def _unknown(_: Season, __: int) -> float:
    return 0.0


class _FortnightRunner:
    def __init__(self, programme: Programme, directory: Path, report: Callable[[str], None]) -> None:
        self._programme = programme
        self._season = programme.season
        self._report = report
        self._plant = FortnightPlant(programme.scenario, self._season.station)
        self._host = ServiceHost(directory, self._plant.ready, programme.changes)
        self._incidents = Incidents(self._host, self._plant, compared=programme.compared)

    def run(self, figure: Path | None) -> FortnightResult:
        played = FortnightResult([])
        with self._host as host:
            for night, name in enumerate(self._programme.evenings):
                played.evenings.append(self._evening(night, name))
                if name == DAMAGE:
                    played.trends["damaged"] = read_trends(host)
                if self._programme.evenings[night + 1 : night + 2] == (DAMAGE,):
                    played.trends["before"] = read_trends(host, figure and figure.with_stem(f"{figure.stem}-before"))
            played.claims["the service ends well"] = host.stop() == 0
            played.rows = read_history(host)
            played.trends["end"] = read_trends(host, figure)
            played.failed = mismatched_rows(host, played.evenings, played.rows)
            played.claims["history as it should be"] = not played.failed
        self._plant.switch_off()
        played.collisions = self._plant.collisions
        return played

    def _evening(self, night: int, name: str) -> Evening:
        began = perf_counter()
        evening = Evening(night, name, self._season.station(night))
        if night:
            self._plant.switch_to_night(night)
        evening.true_before = self._plant.true_um
        if not night:
            self._incidents.prepare(evening)
        for incident in name.split(", "):
            self._incidents.by_name[incident](evening)
        evening.true_after, evening.active_bank = self._plant.true_um, self._plant.active_bank
        evening.claims["the last accepted table acts"] = active_table_is_accepted(self._host, self._plant)
        evening.wall_s = perf_counter() - began
        self._report(line(evening))
        return evening


def _judge(programme: Programme, played: FortnightResult) -> None:
    """Add the claims that compare with the simulator's truth, and collect the names of all failed claims."""
    played.claims["no collision"] = played.collisions == 0
    if programme.compared:
        bound = [e.ratio <= LARGEST_RATIO for e in played.evenings if e.incident != DAMAGE]
        played.claims["true error within its bound"] = all(bound)
        played.claims |= trend_claims(played)
    played.failed += [name for evening in played.evenings for name in evening.failed]
    played.failed += [name for name, held in played.claims.items() if not held]


def trend_claims(played: FortnightResult) -> dict[str, bool]:
    """Return the claims about the trends and alarms in the run history. The value of a claim is True if the claim
    holds.
    """
    before, damaged, end = (played.trends[name] for name in ("before", "damaged", "end"))
    acting = {trend["name"]: trend for trend in before["trends"]}.get("ve_acting", {})
    return {
        "control limits before the damage": acting.get("control_limits") is not None,
        "no tolerance is reached before the damage": not _limits(before),
        "the damage reaches a tolerance": _limits(damaged) == ["held_out"],
        "no tolerance is reached at the end": not _limits(end),
    }


def _limits(trends: dict[str, Any]) -> list[str]:
    """Return the names of the series that have reached their tolerance limit."""
    return [alarm["series"] for alarm in trends["alarms"] if alarm["kind"] == "limit"]


def line(evening: Evening) -> str:
    return (
        f"{evening.night + 1:2d} {evening.incident:25s} station {evening.station}: exit codes "
        f"{evening.exit_codes}, true {evening.true_before:5.2f} -> {evening.true_after:5.2f} µm, "
        f"bank {evening.active_bank}, "
        f"{evening.wall_s:.1f} s {evening.figures or ''} {' '.join(evening.failed)}"
    )
