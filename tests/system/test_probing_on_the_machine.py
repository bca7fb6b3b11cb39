"""Patterns, stages, gates and the qualification on the simulated machine, with virtual time."""

from __future__ import annotations

import dataclasses
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from nights import SCENARIO, Night, document, short_document
from stored_run import stored_run

from agent.errors import MeasurementFault
from agent.execution import steps as s
from agent.execution.device_assembly import assemble
from agent.execution.engine import Engine
from agent.execution.rig import Rig
from agent.planning.cycle_time import walk_plan
from agent.planning.job import Job
from agent.planning.job_preparation import prepare_job
from agent.probing.preparation import PreparationResult
from agent.probing.run_plan import MeasuredPositions, MeasuringOrder, measure_positions
from agent.runs.kinds.calibrate import preflight_of
from agent.settings.schema import Settings
from drivers.clock import VirtualClock
from drivers.errors import ConfigurationError
from drivers.roles import Miss, Touch
from simulators.backend import SimulatedMachineDevice
from twin.artefact.position_set import Position

LOCATING = 5
"""Touches by which the first ball is located before its pattern."""
POSITIONS = (Position(1, 45.0, 0.0), Position(1, 90.0, 45.0))
NO_MOUNT_ERROR = {"index_error_deg": 0.0, "wobble_um": 0.0, "place_error_mm": 0.0, "place_error_deg": 0.0}


@dataclass
class Bench:
    """A machine, mount and artefact without any error, so that every ball stands where it is stated; its probe is not
    so good. `seen`: every step and its result."""

    job: Job
    rig: Rig
    seen: list[tuple[s.Step, object]]

    def run(self, plan: s.Plan[Any]) -> Any:
        return Engine(self.rig.actions(), observer=lambda step, result: self.seen.append((step, result))).run(plan)

    def prepared(self) -> PreparationResult:
        return self.run(self.job.preparation_plan())

    def measured(self, prepared: PreparationResult, positions: tuple[Position, ...]) -> MeasuredPositions:
        order = MeasuringOrder("measure", positions, 1)
        return self.run(measure_positions(order, self.job.layout, prepared.rules))

    @property
    def device(self) -> SimulatedMachineDevice:
        device = self.rig.devices["twin"]
        assert isinstance(device, SimulatedMachineDevice)
        return device

    @property
    def events(self) -> list[dict[str, Any]]:
        return [dict(x.payload) for x, _ in self.seen if isinstance(x, s.Record) and x.kind == "event"]

    def off_um(self, measured: MeasuredPositions) -> np.ndarray:
        """(n, 3) found less stated, all positions."""
        return 1e3 * np.concatenate(
            [
                p.centres_mm
                - self.job.layout.nominal(
                    Position(p.balls[0].station, p.balls[0].azimuth_deg, p.balls[0].elevation_deg)
                )[p.ball_numbers]
                for p in measured.positions
            ]
        )


def bench(state: Path, trigger: dict[str, float], **sections: Any) -> Bench:
    scenario = tomllib.loads(SCENARIO.read_text())
    scenario |= {name: str(SCENARIO.parent / scenario[name]) for name in ("machine", "artefact")}
    scenario["truth"] |= {"scale": 0.0, "deflection": False}
    scenario["artefact_truth"] = {"certificate_error": 0.0, "cte_error": 0.0}
    scenario["mount_behaviour"] = NO_MOUNT_ERROR
    scenario["axes"] = {"repeatability_um": 0.0, "backlash_um": 0.0}
    scenario["temperatures"] = {}
    scenario["trigger"] = trigger
    whole = document(state, devices={"twin": {"driver": "simulated", "options": scenario}}, **sections)
    job = prepare_job(Settings.model_validate(whole), Path.cwd())
    rig = assemble(job.settings, VirtualClock(), Path.cwd())
    rig.open()
    return Bench(job, rig, [])


@pytest.mark.parametrize(("touches", "stages"), [(5, 1), (5, 2), (9, 1), (13, 2), (25, 1)])
def test_each_pattern_measures_every_ball_by_the_same_vectors_without_a_collision(
    state: Path, touches: int, stages: int
) -> None:
    trigger = {"pretravel_um": 8.0, "lobing_um": 0.5, "touch_sigma_um": 1.0}
    machine = bench(state, trigger, procedure={"touches_per_ball": touches, "touch_stages": stages})
    measured = machine.measured(machine.prepared(), POSITIONS)
    assert [len(p.balls) for p in measured.positions] == [11, 11]
    assert measured.unreachable_balls == measured.lost == 0
    assert machine.device.world.collisions == []
    off = machine.off_um(measured)
    assert np.abs(off - off.mean(axis=0)).max() < 4.5
    assert_same_vectors(machine)


def assert_same_vectors(machine: Bench) -> None:
    """Each touch number of every ball goes the same way, but for the turn that a re-centring within 0.3 mm makes."""
    ways: dict[str, list[np.ndarray]] = {}
    start = np.zeros(3)
    for step, _ in machine.seen:
        if (
            isinstance(step, s.TouchTowards)
            and step.key.startswith("measure")
            and not {"repeat", "locate"} & set(step.key.split("/"))
        ):
            way = np.array(step.target_mm) - start
            ways.setdefault(step.key.rsplit("/touch-")[1], []).append(way / np.linalg.norm(way))
        if isinstance(step, s.MoveTo):
            start = np.array(step.target_mm)
    for numbered in ways.values():
        assert np.ptp(np.array(numbered), axis=0).max() < 0.03


def test_dry_run_walk_and_machine_agree_on_what_two_stages_of_nine_touches_take(state: Path) -> None:
    listed = state.parent / "one.csv"
    listed.write_text("station,azimuth_deg,elevation_deg\n1,45,0\n")
    procedure = {"touches_per_ball": 9, "touch_stages": 2, "position_set": str(listed), "stations": [1]}
    trigger = {"pretravel_um": 0.0, "lobing_um": 0.0, "touch_sigma_um": 0.0}
    machine = bench(
        state, trigger, procedure=procedure, verification={"stations": [1], "positions_deg": [[30.0, 30.0]]}
    )
    preflight = preflight_of(machine.job)
    began = machine.rig.clock.now()
    prepared = machine.prepared()
    order = dataclasses.replace(machine.job.measuring_order, standing_at=prepared.standing_at)
    machine.run(measure_positions(order, machine.job.layout, prepared.rules))
    last = next(key for step, _ in reversed(machine.seen) if (key := step.key) in preflight.timeline)
    taken = machine.rig.clock.now() - began
    assert taken == pytest.approx(preflight.timeline[last], rel=0.01)
    _, steps = walk_plan(machine.job, machine.job.preparation_plan())
    walked_s = sum(timed.seconds for timed in steps)
    assert 20.0 < walked_s < 240.0
    assert walked_s == pytest.approx(
        max(t for key, t in preflight.timeline.items() if key.startswith("probe/")), rel=0.01
    )


LOBED = {"pretravel_um": 8.0, "lobing_um": 3.0, "touch_sigma_um": 0.1}


@pytest.mark.parametrize("with_map", [False, True])
def test_lobing_of_3_um_biases_centres_without_the_map_and_no_more_with_it(state: Path, with_map: bool) -> None:
    """The bias common to all balls cancels in differences in either case, since all balls share their touch vectors."""
    machine = bench(state, LOBED, qualification={"pretravel_map": with_map})
    prepared = machine.prepared()
    off = machine.off_um(machine.measured(prepared, POSITIONS))
    common = off.mean(axis=0)
    assert np.abs(off - common).max() < 0.4
    if with_map:
        assert np.linalg.norm(common[[0, 2]]) < 0.4
    else:
        assert 2.5 < np.linalg.norm(common[[0, 2]]) < 3.5
    qualification = prepared.qualification
    assert qualification is not None
    assert qualification.stylus.radius_mm == pytest.approx(15.5 - 8e-3, abs=2e-4)
    assert (qualification.stylus.pretravel is not None) is with_map


def test_common_pretravel_moves_every_centre_alike_and_not_at_all_with_the_qualified_radius(state: Path) -> None:
    found = {}
    for enabled in (False, True):
        trigger = {"pretravel_um": 15.0, "lobing_um": 0.0, "touch_sigma_um": 0.05}
        machine = bench(state, trigger, qualification={"enabled": enabled})
        found[enabled] = machine.off_um(machine.measured(machine.prepared(), POSITIONS[:1]))
    for off in found.values():
        assert np.abs(off).max() < 0.4


def test_a_probe_that_does_not_repeat_stops_before_anything_is_measured(state: Path) -> None:
    machine = bench(
        state,
        {"pretravel_um": 8.0, "lobing_um": 0.0, "touch_sigma_um": 8.0},
        procedure={"form_limit_um": 100.0, "touch_limit_um": 100.0, "radius_limit_um": 100.0},
    )
    with pytest.raises(MeasurementFault, match="does not repeat: 2σ"):
        machine.prepared()
    assert not any(isinstance(step, s.Record) and step.kind == "ball" for step, _ in machine.seen)


class DirtyOnce:
    """A probe that trips 60 µm early on named touches: a crumb that the first contact wipes away."""

    def __init__(self, probe: Any, dirty: set[int]) -> None:
        self._probe = probe
        self._dirty = dirty
        self._count = 0

    def probe_status(self) -> Any:
        return self._probe.probe_status()

    def touch_towards(self, target_mm: np.ndarray, *, feed_mm_per_s: float) -> Touch | Miss:
        start = self._probe.position()
        result = self._probe.touch_towards(target_mm, feed_mm_per_s=feed_mm_per_s)
        self._count += 1
        if self._count not in self._dirty or not isinstance(result, Touch):
            return result
        way = (target_mm - start) / np.linalg.norm(target_mm - start)
        x, y, z = (np.array(result.position_mm) - 0.06 * way).tolist()
        return Touch((x, y, z))


def test_a_crumb_is_noticed_named_and_cleaned_up(state: Path) -> None:
    trigger = {"pretravel_um": 8.0, "lobing_um": 0.5, "touch_sigma_um": 1.0}
    machine = bench(state, trigger, procedure={"touches_per_ball": 9}, probe_check={"enabled": False},
                    qualification={"enabled": False}, reversal={"enabled": False})  # fmt: skip
    machine.rig = dataclasses.replace(machine.rig, probe=DirtyOnce(machine.device, {LOCATING + 9 + 4}))
    measured = machine.measured(machine.prepared(), POSITIONS[:1])
    assert [len(p.balls) for p in measured.positions] == [11]
    gates = [event for event in machine.events if "gate" in event]
    assert [event["ball"] for event in gates] == ["measure/station-1/az45-el0/ball-10"]
    assert gates[0]["gate"] in ("radius", "form")
    assert gates[0]["then"].startswith("clean-up of touch ")
    assert "3" in gates[0]["then"]
    off = machine.off_um(measured)
    assert np.abs(off - off.mean(axis=0)).max() < 4.5


class DirtyBall(DirtyOnce):
    """A probe that trips 60 µm early at every sideways touch, or only at the first one, of the ball at the axis
    positions `centre_mm`: a particle sticks to it."""

    def __init__(self, probe: Any, centre_mm: np.ndarray, *, wiped_away: bool) -> None:
        super().__init__(probe, set())
        self._centre_mm = centre_mm
        self._wiped_away = wiped_away
        self._wiped = False

    def touch_towards(self, target_mm: np.ndarray, *, feed_mm_per_s: float) -> Touch | Miss:
        here = np.linalg.norm(target_mm - self._centre_mm) < 20.0
        sideways = abs((target_mm - self._centre_mm)[1]) < 1.0
        self._dirty = {self._count + 1} if here and sideways and not self._wiped else set()
        self._wiped = self._wiped or (bool(self._dirty) and self._wiped_away)
        return super().touch_towards(target_mm, feed_mm_per_s=feed_mm_per_s)


THREE_TOUCHES = {"touches_per_ball": 3, "approach_mm": 1.5, "touch_feed_mm_per_min": 480.0}


def with_dirty_ball(state: Path, *, wiped_away: bool, **procedure: object) -> tuple[Bench, PreparationResult]:
    trigger = {"pretravel_um": 8.0, "lobing_um": 0.5, "touch_sigma_um": 1.0}
    machine = bench(state, trigger, procedure={**THREE_TOUCHES, **procedure})
    prepared = machine.prepared()
    machine.seen.clear()
    centre_mm = machine.job.layout.nominal(POSITIONS[0])[4]
    machine.rig = dataclasses.replace(machine.rig, probe=DirtyBall(machine.device, centre_mm, wiped_away=wiped_away))
    return machine, prepared


def test_a_wrong_touch_of_three_is_found_by_the_other_balls_and_repeated_before_the_position_is_left(
    state: Path,
) -> None:
    machine, prepared = with_dirty_ball(state, wiped_away=True)
    measured = machine.measured(prepared, POSITIONS[:1])
    assert [one.lost for one in measured.positions] == [0]
    assert measured.positions[0].touches == 5 + 13 * 3  # located; 11 balls, ball 4 once more, the first ball again
    (event,) = [event for event in machine.events if event.get("then") == "repeat the ball"]
    assert event["ball"] == 4
    assert "predict, allowed" in event["reason"]
    turned = [number for number, (step, _) in enumerate(machine.seen) if isinstance(step, s.OrientTo)]
    repeated = [number for number, (step, _) in enumerate(machine.seen) if "/once-more" in step.key]
    assert len(turned) == 1
    assert turned[0] < min(repeated)
    off = machine.off_um(measured)
    assert np.abs(off - off.mean(axis=0)).max() < 5.0
    rows = [step.payload for step, _ in machine.seen if isinstance(step, s.Record) and step.kind == "ball"]
    assert sorted(row["ball"] for row in rows) == list(range(11))
    assert all(row["radius_mm"] is None and row["form_mm"] is None for row in rows)


def test_a_particle_that_stays_costs_the_ball_not_the_position(state: Path) -> None:
    machine, prepared = with_dirty_ball(state, wiped_away=False)
    (position,) = machine.measured(prepared, POSITIONS[:1]).positions
    assert position.ball_numbers.count(4) == 0
    assert (len(position.balls), position.lost) == (10, 1)
    (lost,) = [event for event in machine.events if event.get("ball") == 4 and "then" not in event]
    assert "beside the place that the other balls" in lost["reason"]


def test_a_particle_that_stays_ends_a_run_that_is_to_stop(state: Path) -> None:
    machine, prepared = with_dirty_ball(state, wiped_away=False, on_failure="stop")
    with pytest.raises(MeasurementFault, match=r"ball 4 does not fit the other balls of its position: touch [12] is "):
        machine.measured(prepared, POSITIONS[:1])


def test_three_touches_without_a_qualified_radius_are_refused(state: Path) -> None:
    with pytest.raises(ConfigurationError, match="3 touches do not determine the radius") as refused:
        bench(state, {}, procedure=THREE_TOUCHES, qualification={"enabled": False})
    assert refused.value.where["key"] == "procedure.touches_per_ball"


def test_a_run_journals_and_reports_what_it_found_of_the_probe(state: Path, monkeypatch: pytest.MonkeyPatch) -> None:

    ended = Night().run(short_document(state, qualification={"pretravel_map": True}))
    assert ended.error is None
    page = (state / ended.outcome.run_id / "report.html").read_text()
    assert "Probe and stylus" in page
    assert 'data-figure="qualification"' in page
    assert "effective radius 15.49" in page
    kinds = [decision.kind for decision in stored_run(state).decisions]
    assert sum("qualify/stylus" in kind for kind in kinds) == 1
    assert sum("check/repeatability" in kind for kind in kinds) == 1
