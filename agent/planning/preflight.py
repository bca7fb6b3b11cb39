"""Preflight, which executes the complete plan of a run on a simulated machine before the real machine moves.

The plan is the one that the run will carry out, walked in every branch (`agent.planning.branch_walk`). The simulation
runs in virtual time. The simulated machine moves like the real machine, and the time model of the run
(`agent.planning.time_model`) adds the latencies of the commands. One simulated device has all roles of the rig.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from agent.errors import Aborted, Interrupted, MeasurementFault, PlanRefused
from agent.execution.device_assembly import mount_at_station, stations_of
from agent.execution.rig import Rig, in_role
from agent.execution.steps import Point
from agent.planning.branch_walk import Branch, BranchWalk
from agent.planning.cycle_time import TimedStep
from agent.planning.job import Job, Planner
from agent.planning.safety_rules import safety_rules
from agent.planning.time_model import time_model
from agent.probing.run_plan import MEASURED, VERIFIED, MeasuredPositions, position_key
from drivers.clock import VirtualClock, wall_seconds
from drivers.errors import ConfigurationError, DeviceError
from drivers.registry import DeviceContext, create_device
from drivers.roles import CompensationStore, Machine, Operator, Probe, Thermometer
from twin.units import S_PER_MIN


@dataclass(frozen=True)
class Standing:
    """Place of the artefact between two positions: its station, and the azimuth and elevation of the mount there."""

    station: int
    azimuth_deg: float
    elevation_deg: float


NOTHING_MEASURED = MeasuredPositions((), (), 0, None, {})


@dataclass(frozen=True)
class PreflightResult:
    """Result of a preflight, the simulated execution of a whole plan.

    `branches` contains the walked branches, the expected one first, and then those in which the run is stopped and the
    probe withdrawn. If only the expected branch was asked for, it is the only one. `wall_seconds` is the time that the
    computation took. All other figures are those of the expected branch: the simulated measurements for the estimate
    and those that verify the new table, the machine time in s at the end of each step, the steps that take time, the
    machine time and the number of steps.
    """

    branches: tuple[Branch, ...]
    wall_seconds: float

    @property
    def expected(self) -> Branch:
        return self.branches[0]

    @property
    def measured(self) -> MeasuredPositions:
        return self.expected.concluded.get(MEASURED, NOTHING_MEASURED)

    @property
    def verified(self) -> MeasuredPositions:
        return self.expected.concluded.get(VERIFIED, self.measured)

    @property
    def timeline(self) -> Mapping[str, float]:
        return self.expected.timeline

    @property
    def steps(self) -> Sequence[TimedStep]:
        return self.expected.steps

    @property
    def machine_seconds(self) -> float:
        return self.expected.machine_seconds

    @property
    def machine_minutes(self) -> float:
        return self.machine_seconds / S_PER_MIN

    @property
    def longest_minutes(self) -> float:
        """Machine time in min of the longest branch in which the run is not stopped before its end."""
        return max(branch.machine_minutes for branch in self.ends)

    @property
    def commands(self) -> int:
        return len(self.timeline)

    @property
    def ends(self) -> tuple[Branch, ...]:
        """Branches in which the run is not stopped before its end."""
        return tuple(branch for branch in self.branches if not branch.is_withdrawal)


def never_interrupted() -> None:
    """Do nothing. A preflight that cannot be interrupted calls this function after every step."""


def run_preflight(
    job: Job,
    plan_of: Planner,
    start_mm: Point | None = None,
    watch: Callable[[], None] = never_interrupted,
    *,
    every_branch: bool = True,
    standing: Standing | None = None,
) -> PreflightResult:
    """Execute the plan of a whole run on a simulated machine without errors.

    `plan_of` returns the plan of the run of `job`. `start_mm` contains the axis positions of the real machine in mm. If
    it is None, the simulated machine starts at its own initial positions. `watch` is called after every step and may
    raise an error to interrupt the preflight. If `every_branch` is False, only the expected branch is executed, which
    suffices to compare the machine times of several plans. `standing` is the place of the artefact at the start; if it
    is None, it is that of the settings, with both angles of the mount zero.

    Raises PlanRefused if a step breaks a safety rule or fails; the error names the step and, for a collision, the two
    bodies that collide. Raises ConfigurationError if the plan measures positions or verifies a table, but no position
    can be measured. Errors raised by `watch` are passed on.
    """
    began, clock = wall_seconds(), VirtualClock()
    rig = assemble_preflight_rig(job, clock, start_mm, standing)
    rules = safety_rules(job.settings.procedure, job.settings.stations, carried=not job.rules.change.own_mounts)
    model = time_model(job.machine, job.settings.timing)
    rig.open()
    try:
        with _refused_as_plan(job):
            withdrawn_by = job.rules if every_branch else None
            walk = BranchWalk(rig, clock, rules, model, watch, withdrawn_by, _last_s=clock.now())
            plan = plan_of(job)
            ends = list(walk.branches(plan)) if every_branch else [walk.expected(plan)]
    finally:
        rig.close()
    for branch in ends:
        _require_measured(branch)
    return PreflightResult((*ends, *walk.withdrawals), wall_seconds() - began)


@contextmanager
def _refused_as_plan(job: Job) -> Iterator[None]:
    try:
        yield
    except (Aborted, Interrupted) as end:  # belongs to no step of the machine
        raise type(end)(end.message, hint=end.hint) from end
    except (DeviceError, MeasurementFault) as error:
        hint = _what_to_do(job, error.where.get("step", ""))
        raise PlanRefused(f"preflight: {error.message}", hint=hint, **error.where) from error


def _what_to_do(job: Job, step: str) -> str:
    if job.settings.verification.positions_deg is None and any(f"/{position_key(p)}/" in step for p in job.held_out):
        return "nothing was moved; list other held-out positions in `verification.positions_deg`"
    if job.settings.procedure.paths == "plain":
        return (
            'nothing was moved; plain paths are not proved free; `procedure.paths = "shortest"` searches for free ones'
        )
    return "nothing was moved; the plan must change"


def _require_measured(branch: Branch) -> None:
    """Raise ConfigurationError if a branch measures or verifies, but no position was measured: a new table could not be
    verified, or a machine could not be compared."""
    noted = [branch.concluded[role] for role in (VERIFIED, MEASURED) if role in branch.concluded]
    if noted and not noted[0].positions:
        raise ConfigurationError(
            "no held-out position has three balls within reach, so a new table could not be proved",
            key="verification.positions_deg",
            hint="choose orientations that the machine reaches at the stations of `verification`",
        )


def assemble_preflight_rig(
    job: Job, clock: VirtualClock, start_mm: Point | None, standing: Standing | None = None
) -> Rig:
    """Return a rig for the simulated execution of the plan of `job`. One simulated device has all roles: machine,
    probe, mount and so on.

    The setting `preflight.driver` names the driver of this device. The device simulates the machine described by the
    machine file, but without geometric errors, because a preflight checks only the procedure. `standing` is the place
    of the artefact at the start, as for `run_preflight`.
    """
    settings = job.settings
    options: dict[str, object] = {
        "machine": str(settings.machine),
        "artefact": str(settings.artefact),
        "tool": settings.tool,
        "mount": vars(settings.mount),
        "probe": vars(job.layout.probe),
        "stations_mm": [list(place) for place in settings.stations.places_mm],
        "standing_at": settings.stations.standing_at or 1,
        "mount_behaviour": settings.timing.model_dump(include={"speed_deg_per_s", "acceleration_deg_per_s2"}),
        "ideal": True,
        **_own_at_stations(job),
    }
    if start_mm is not None:
        options["start_mm"] = list(start_mm)
    if standing is not None:
        options |= _standing_options(job, standing)
    context = DeviceContext("preflight", clock, settings.machine.parent)
    device = create_device(settings.preflight.driver, options, context)
    devices = {"preflight": device}
    return Rig(
        devices=devices,
        machine=in_role(devices, "preflight", Machine, "preflight.driver"),
        probe=in_role(devices, "preflight", Probe, "preflight.driver"),
        mounts={
            n: mount_at_station(devices, "preflight", n, "preflight.driver")
            for n in stations_of(settings.stations)
            if not settings.stations.placed_by_hand
        },
        store=in_role(devices, "preflight", CompensationStore, "preflight.driver"),
        thermometer=in_role(devices, "preflight", Thermometer, "preflight.driver"),
        operator=in_role(devices, "preflight", Operator, "preflight.driver"),
        clock=clock,
    )


def _standing_options(job: Job, standing: Standing) -> dict[str, object]:
    """Return the options of the simulated machine that say where the artefact stands. Mounts of the other stations are
    parked."""
    angles = [standing.azimuth_deg, standing.elevation_deg]
    change = job.rules.change
    if not change.own_mounts:
        return {"standing_at": standing.station, "mounts_deg": [angles]}
    parked = list(change.parked_deg)
    return {"mounts_deg": [angles if station == standing.station else parked for station in change.own_mounts]}


def _own_at_stations(job: Job) -> dict[str, object]:
    """Return additional options of the simulated machine if the artefact is placed by hand or if each station has a
    mount of its own, else an empty dict."""
    change, settings = job.rules.change, job.settings
    if settings.stations.placed_by_hand:
        return {"placed_by_hand": {}}
    if not change.own_mounts:
        return {}
    return {
        "own_mounts": True,
        "artefacts": [str(path) for path in settings.stations.artefacts or ()],
        "mounts_deg": [list(change.parked_deg)] * len(change.own_mounts),
    }
