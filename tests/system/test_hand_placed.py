"""An artefact that a person places by hand in every position: wrong placements, interruptions, and what is refused."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from nights import CONFIG, Night, merged
from stored_run import StoredRun, stored_run
from test_whole_run_interrupted import Cut, with_device

from agent.errors import MeasurementFault
from agent.execution.rig import Rig
from agent.execution.states import RunState
from agent.planning.job_preparation import prepare_job
from agent.runs.kinds import nightly
from agent.runs.kinds.verify import Verification
from agent.runs.planned_run import Kind, StartConditions
from agent.runs.resume.resume import resume
from agent.runs.session import RunResult
from agent.settings.schema import Settings
from drivers.errors import ConfigurationError, LinkLost

SHIPPED = tomllib.loads((CONFIG / "hand-placed.toml").read_text())
SCENARIO = CONFIG / "simulators" / "hand-placed.toml"
POSITIONS = "station,azimuth_deg,elevation_deg\n3,30,0\n3,-90,0\n3,150,0\n"
FIRST, SECOND = "station-3/az30-el0", "station-3/az-90-el0"


def document(state: Path, **hand: Any) -> dict[str, Any]:
    """Three positions at one station and one held out; a machine so bad, gates so wide, that all is let through."""
    listed = state.parent / "positions.csv"
    listed.write_text(POSITIONS)
    scenario = tomllib.loads(SCENARIO.read_text())
    scenario |= {name: str((SCENARIO.parent / scenario[name]).resolve()) for name in ("machine", "artefact")}
    scenario["truth"]["scale"] = 4.0
    scenario["placed_by_hand"] |= hand
    scenario["noise_by_step"] = True
    own = {
        "machine": str(CONFIG / SHIPPED["machine"]),
        "artefact": str(CONFIG / SHIPPED["artefact"]),
        "state_directory": str(state),
        "devices": {"twin": {"driver": "simulated", "options": scenario}},
        "roles": dict.fromkeys(("machine", "probe", "store", "thermometer", "operator"), "twin"),
        "procedure": {"position_set": str(listed), "stations": [3]},
        "verification": {"stations": [3], "positions_deg": [[60.0, 0.0]], "max_chi2": 1e3},
        "gates": {
            "min_degrees_of_freedom": 1,
            "max_unmeasured_fraction": 10.0,
            "max_chi2": 1e3,
            "max_slope_um_per_mm": 10.0,
            "max_correction_um": 1e3,
        },
    }
    shipped = {name: value for name, value in SHIPPED.items() if name not in ("clock", "devices", "roles")}
    return {**merged(shipped, own), "devices": own["devices"], "roles": own["roles"]}


def asked(run: StoredRun) -> list[str]:
    """Keys of the placements that a person was asked for, in order."""
    return [step.key.removesuffix("/by-hand") for step in run.steps_of("AskOperator")]


def refusals(run: StoredRun) -> list[str]:
    return [event.record["reason"] for event in run.events if event.record_text and "/refused" in event.record_text]


def ended_well(night: Night, ended: RunResult) -> None:
    assert ended.error is None, ended.error
    assert ended.outcome.state is RunState.COMPLETE
    assert night.world is not None
    assert night.world.collisions == []
    assert night.active != 0


def test_the_measurement_follows_the_artefact_where_it_stands(state: Path) -> None:
    night = Night()
    ended_well(night, night.run(document(state, error_mm=4.0, error_deg=1.2), files=False))
    run = stored_run(state)
    shifts = [event.record["shift_mm"] for event in run.events if "shift_mm" in event.record_text]
    assert max(shifts) > 1.0
    # One placement for each position; the one at which the probe was checked and the held-out one are not repeated.
    assert asked(run) == [
        f"probe/{FIRST}/place-1",
        f"measure/{SECOND}/place-1",
        "measure/station-3/az150-el0/place-1",
        "measure/station-3/az60-el0/place-1",
    ]


SHIFTED: tuple[tuple[dict[str, Any], str], ...] = (
    ({"off_mm": [120.0, 0.0, 0.0]}, "ball"),
    ({"off_mm": [0.0, -9.0, 0.0]}, "mm from its place"),
    ({"off_mm": [0.0, 0.0, 10.0]}, "above the place"),
    ({"off_mm": [0.0, 0.0, 40.0]}, "met it at the retreat plane"),  # the artefact reaches above that plane
)
TURNED: tuple[tuple[dict[str, Any], str], ...] = (
    ({"off_deg": 3.0}, "turned by"),
    ({"off_deg": 40.0}, "ball"),
    ({"off_deg": 120.0}, "ball"),
    ({"off_deg": 180.0}, "ball"),
)


@pytest.mark.parametrize("wrong", [SHIFTED, TURNED])
def test_wrong_placements_are_refused_one_after_the_other_and_asked_for_again(
    state: Path, wrong: tuple[tuple[dict[str, Any], str], ...]
) -> None:
    night = Night()
    misplaced = [{"placement": number, **gross} for number, (gross, _) in enumerate(wrong, start=2)]
    settings = document(state, misplaced=misplaced)
    settings["stations"]["placement_attempts"] = 1 + len(wrong)
    ended_well(night, night.run(settings, files=False))
    run = stored_run(state)
    found = refusals(run)
    assert len(found) == len(wrong)
    for refused, (_, said) in zip(found, wrong, strict=True):
        assert said in refused
    for number, again in enumerate(run.steps_of("AskOperator")[2 : 2 + len(wrong)], start=2):
        assert again.key == f"measure/{SECOND}/place-{number}/by-hand"
        request = again.detail["request"]
        assert request["refused"] != ""
        assert "The last placement was refused" in request["text"]


class NobodyPlaces:
    """Device whose operator says that it is done and places nothing."""

    def __init__(self, device: Any) -> None:
        self._device = device

    def __getattr__(self, name: str) -> Any:
        return getattr(self._device, name)

    def ask(self, _: object) -> bool:
        return True


def test_an_artefact_that_is_not_there_is_asked_for_until_the_attempts_are_used_up(state: Path) -> None:
    night = Night(tamper=lambda rig: with_device(rig, NobodyPlaces(rig.devices["twin"])))
    settings = document(state)
    settings["stations"]["placement_attempts"] = 2
    ended = night.run(settings, files=False)
    assert isinstance(ended.error, MeasurementFault)
    assert "placed 2 times" in ended.error.message
    assert night.world is not None
    assert night.world.collisions == []
    assert [text.split(": ")[1][:6] for text in refusals(stored_run(state))] == ["ball 3"] * 2


@dataclass
class Interrupted:
    """Run that lost its link just before a call of its only device, and the machine as it was left."""

    state: Path
    cuts: list[tuple[str, int]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.night = Night(tamper=self._tamper)

    def _tamper(self, rig: Rig) -> Rig:
        if not self.cuts:
            return rig
        return with_device(rig, Cut(rig.devices["twin"], *self.cuts.pop(0), self._lose))

    @staticmethod
    def _lose() -> None:
        raise LinkLost("connection reset", link="127.0.0.1:502")

    def begin(self) -> StoredRun:
        ended = self.night.run(document(self.state), files=False)
        assert isinstance(ended.error, LinkLost), ended
        return stored_run(self.state)

    def resume(self) -> RunResult:
        return resume(self.state, self.night.hooks)


IN_A_BALL = ("touch_towards", 214)
WHILE_LOCATING = ("touch_towards", 183)


def test_an_artefact_still_in_place_is_found_again_and_nobody_is_asked_again(state: Path) -> None:
    broken = Interrupted(state, [IN_A_BALL])
    before = broken.begin()
    ended_well(broken.night, broken.resume())
    run = stored_run(state)
    assert run.balls[: len(before.balls)] == before.balls
    assert run.measured_twice == []
    assert len(asked(run)) == 4
    assert any(step.key == "resume-1/placed-0/down" for step in run.steps)


@pytest.mark.parametrize("moved", ["taken away", "elsewhere"])
@pytest.mark.parametrize("cut", [IN_A_BALL, WHILE_LOCATING])
def test_an_artefact_moved_meanwhile_is_placed_again_and_complete_positions_are_kept(
    state: Path, cut: tuple[str, int], moved: str
) -> None:
    broken = Interrupted(state, [cut])
    before = broken.begin()
    complete = [ball for ball in before.balls if f"/{FIRST}/" in ball.key]
    assert complete
    world = broken.night.world
    assert world is not None
    if moved == "taken away":
        world.remove_artefact()
    else:
        world.workpiece.shift((14.0, -20.0, 0.0), 8.0)
    ended_well(broken.night, broken.resume())
    run = stored_run(state)
    assert [ball for ball in run.balls if f"/{FIRST}/" in ball.key] == complete
    again = [key for key in asked(run) if "/again-1/" in key]
    assert again == [f"measure/{SECOND}/again-1/place-1"]
    whole = {ball.record["position"] for ball in run.balls if f"/{SECOND}/again-1/" in ball.key}
    partial = {ball.record["position"] for ball in run.balls if f"/{SECOND}/ball" in ball.key}
    assert len(whole) == 1
    assert whole & partial == set()


def test_a_second_interruption_comes_to_the_same_decision(state: Path) -> None:
    broken = Interrupted(state, [IN_A_BALL, ("touch_towards", 60)])
    broken.begin()
    assert broken.night.world is not None
    broken.night.world.remove_artefact()
    assert isinstance(broken.resume().error, LinkLost)
    ended_well(broken.night, broken.resume())
    run = stored_run(state)
    assert run.measured_twice == []
    assert [key for key in asked(run) if "/again-" in key] == [f"measure/{SECOND}/again-1/place-1"]


@pytest.mark.parametrize("kind", [Verification(), nightly.Night()])
def test_runs_without_a_person_are_refused_before_anything_moves(state: Path, kind: Kind) -> None:
    job = prepare_job(Settings.model_validate(document(state)), Path.cwd())
    with pytest.raises(ConfigurationError, match="nobody to place it") as refused:
        kind.plan(job, StartConditions(1, "2026-11-23T00:00:00Z", (0.0, 0.0, 400.0)), lambda: None)
    assert refused.value.where["key"] == "stations.placed_by_hand"
