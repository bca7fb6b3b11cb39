"""Verification and night on the machine of a short calibration: within limits, out of limits, refused, carried over."""

from __future__ import annotations

import copy
import json
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from click.testing import Result
from nights import Night, short_document
from stored_run import stored_run
from volcal_command import volcal

import agent.cli.run_commands.night_options
from agent.errors import GateRefused, PlanRefused
from agent.execution.run_record import run_ids
from agent.execution.states import RunState
from agent.results.run_outcome import Decision, Outcome
from agent.runs.kinds import nightly
from agent.runs.kinds.verify import Verification
from agent.runs.reference_state import COPY_NAME, full_calibration_need, read_reference, write_copy
from agent.runs.run_context import RunHooks
from agent.runs.session import RunResult
from agent.settings.schema import Settings
from drivers.errors import ConfigurationError
from twin.formats.estimate_file import parse_estimate

COLLISION = {"night": 1, "collision_night": 1, "collision": {"B0Z": 120.0}}
NIGHTLY = {"slot_minutes": 30.0, "check_positions": 1}


@dataclass
class Calibrated:
    """A machine after its first calibration, and the settings for what follows."""

    night: Night
    state: Path
    settings: dict[str, Any]
    first: RunResult

    def run(self, kind: Any, **sections: Any) -> RunResult:
        return self.night.run({**self.settings, **sections}, kind=kind, files=False)


@pytest.fixture(scope="module")
def calibrated() -> Iterator[Calibrated]:
    """Nobody works on it: each test has a copy."""
    with TemporaryDirectory() as directory:
        state = Path(directory) / "state"
        settings = short_document(state, nightly=NIGHTLY)
        night = Night()
        first = night.run(settings, files=False)
        assert first.outcome.state is RunState.COMPLETE
        assert first.outcome.proof is not None
        assert first.outcome.proof.accepted
        yield Calibrated(night, state, settings, first)


@pytest.fixture
def machine(calibrated: Calibrated) -> Iterator[Calibrated]:
    with TemporaryDirectory() as directory:
        state = Path(directory) / "state"
        shutil.copytree(calibrated.state, state)
        settings = copy.deepcopy(calibrated.settings) | {"state_directory": str(state)}
        yield Calibrated(Night(world=copy.deepcopy(calibrated.night.world)), state, settings, calibrated.first)


def told(outcome: Outcome) -> Decision:
    assert outcome.night is not None
    return outcome.night.decision


def test_without_an_accepted_night_there_is_nothing_to_compare_with(monkeypatch: pytest.MonkeyPatch) -> None:
    with TemporaryDirectory() as directory:
        settings = short_document(Path(directory) / "state")
        for kind in (Verification(), nightly.Night()):
            ended = Night().run(settings, kind=kind, files=False)
            assert isinstance(ended.error, ConfigurationError)
            assert "volcal calibrate" in str(ended.error)
            assert ended.outcome.state is RunState.REFUSED


def test_verification_compares_and_writes_nothing(machine: Calibrated) -> None:
    before = (machine.night.active, dict(machine.night.banks))
    ended = machine.run(Verification(nights=1.0))
    assert ended.error is None
    assert told(ended.outcome) is Decision.WITHIN
    assert ended.outcome.state is RunState.COMPLETE
    assert (machine.night.active, dict(machine.night.banks)) == before
    night = ended.outcome.night
    assert night is not None
    assert night.since == machine.first.outcome.run_id
    assert night.positions == 2
    assert night.finds is not None
    assert night.finds.size is not None
    assert night.warning == ""  # all balls were measured: the smallest step found is the planned one, within 10 %
    document = ended.outcome.as_json()
    assert document["kind"] == "verify"
    assert document["night"]["decision"] == "within limits"  # type: ignore[index]
    run = stored_run(machine.state, ended.outcome.run_id)
    kinds = [decision.kind for decision in run.decisions if not decision.kind.startswith("probe/")]
    assert kinds.count("verify") == 1
    assert not {"publish/staged", "activate/activated", "accepted"} & set(kinds)
    assert run.states == ["preflight", "measuring", "identifying", "complete"]
    last = read_reference(machine.state)
    assert last is not None
    assert last.run_id == machine.first.outcome.run_id


def test_copy_beside_the_journal_is_an_estimate_to_go_on_from(machine: Calibrated) -> None:
    machine.night.run(machine.settings)
    kept = machine.state / COPY_NAME
    last = read_reference(machine.state)
    assert last is not None
    if last.run_id != machine.first.outcome.run_id:
        assert parse_estimate(kept.read_text(), str(kept)).carried_over().mean == pytest.approx(last.estimate.z)
    write_copy(machine.state, last.run_id)
    assert parse_estimate(kept.read_text(), str(kept)).parameters == pytest.approx(last.estimate.parameters)
    assert last.nights_until("2100-01-01T00:00:00.000Z") > 20000.0


def test_a_collision_is_out_of_limits_and_leads_to_a_full_calibration(machine: Calibrated) -> None:
    """Verified, noticed at night, kept while nobody permits, done where somebody does, and then forgotten."""
    machine.night.changed(**COLLISION)
    verified = machine.run(Verification(nights=1.0))
    assert told(verified.outcome) is Decision.OUT
    assert verified.error is None
    assert full_calibration_need(machine.state) is None
    noticed = machine.run(nightly.Night(nights=1.0))
    assert isinstance(noticed.error, GateRefused)
    assert told(noticed.outcome) is Decision.FULL_NEEDED
    pending = full_calibration_need(machine.state)
    assert pending is not None
    assert pending.run_id == noticed.outcome.run_id
    waiting = machine.run(nightly.Night(nights=2.0))
    assert told(waiting.outcome) is Decision.FULL_NEEDED
    assert pending.run_id in str(waiting.error)
    assert full_calibration_need(machine.state) == pending
    assert machine.night.active == machine.first.outcome.table_bank
    done = machine.run(nightly.Night(nights=2.0, full_allowed=True))
    assert done.error is None
    assert told(done.outcome) is Decision.FULL_DONE
    assert full_calibration_need(machine.state) is None
    assert machine.night.active == done.outcome.table_bank != machine.first.outcome.table_bank
    last = read_reference(machine.state)
    assert last is not None
    assert last.run_id == done.outcome.run_id


def test_the_full_calibration_follows_the_same_night_if_permitted_and_long_enough(machine: Calibrated) -> None:
    machine.night.changed(**COLLISION)
    ended = machine.run(nightly.Night(slot_minutes=60.0, full_allowed=True, nights=1.0))
    assert ended.error is None
    assert told(ended.outcome) is Decision.FULL_DONE
    assert ended.outcome.state is RunState.COMPLETE
    assert ended.outcome.proof is not None
    decisions = [one for run_id in run_ids(machine.state) for one in stored_run(machine.state, run_id).decisions]
    assert sum(one.kind == "gate" and '"change"' in one.record_text for one in decisions) == 1


def test_a_slot_that_is_too_short_is_refused_before_anything_moves(machine: Calibrated) -> None:
    ended = machine.run(nightly.Night(slot_minutes=3.0, nights=1.0))
    assert isinstance(ended.error, PlanRefused)
    assert "3 min is too short" in str(ended.error)
    assert stored_run(machine.state, ended.outcome.run_id).steps == ()


def test_a_night_stays_inside_its_slot_and_goes_on_from_the_last(machine: Calibrated) -> None:
    ended = machine.run(
        nightly.Night(slot_minutes=16.0, nights=1.0), gates={**machine.settings["gates"], "max_change": 50.0}
    )
    assert told(ended.outcome) in (Decision.FUSED, Decision.WRITTEN), ended.outcome.reason
    assert ended.outcome.machine_minutes <= 16.0
    last = read_reference(machine.state)
    assert last is not None
    assert last.run_id == ended.outcome.run_id
    assert machine.night.active == ended.outcome.table_bank


def test_another_table_than_the_accepted_one_is_none_to_go_on_from(machine: Calibrated) -> None:
    assert machine.night.world is not None
    machine.night.world.controller.activate(0)
    ended = machine.run(Verification(nights=1.0))
    assert isinstance(ended.error, GateRefused)
    assert "does not hold the table accepted" in str(ended.error)
    assert ended.outcome.state is RunState.REFUSED
    assert machine.night.active == 0


def test_another_machine_is_refused_by_name(machine: Calibrated, tmp_path: Path) -> None:
    other = tmp_path / "other.toml"
    shipped = Path(machine.settings["machine"])
    text = shipped.read_text().replace(
        '"case-study-deflection.csv"', f'"{shipped.parent / "case-study-deflection.csv"}"'
    )
    other.write_text(text)
    ended = machine.run(Verification(nights=1.0), machine=str(other))
    assert isinstance(ended.error, ConfigurationError)
    assert "it was of machine case-study.toml, not other.toml" in str(ended.error)


class Commands:
    """Commands `volcal verify` and `volcal nightly` on the machine of the fixture."""

    def __init__(self, machine: Calibrated, monkeypatch: pytest.MonkeyPatch) -> None:
        self._machine = machine
        monkeypatch.setattr(
            agent.cli.run_commands.night_options, "load_settings", lambda _: Settings.model_validate(machine.settings)
        )
        monkeypatch.setattr(
            "agent.cli.run_commands.local_run.RunHooks", partial(RunHooks, devices=machine.night.hooks.devices)
        )

    def run(self, *arguments: str) -> Result:
        return volcal(*arguments, "--nights", "1", "--config", "volcal.toml", exit_code=None)


def test_the_exit_code_of_the_commands_states_whether_the_machine_is_within_limits(
    machine: Calibrated, monkeypatch: pytest.MonkeyPatch
) -> None:
    commands = Commands(machine, monkeypatch)
    verified = commands.run("verify", "--json")
    assert verified.exit_code == 0, verified.output
    assert json.loads(verified.stdout)["night"]["decision"] == "within limits"
    machine.settings["gates"]["max_change"] = 50.0
    kept = commands.run("nightly", "--slot", "0.3h", "--json")
    document = json.loads(kept.stdout)
    assert document["kind"] == "nightly"
    assert document["machine_minutes"] <= 18.0
    assert kept.exit_code == (4 if document["verified"] is False else 0)
    assert Path(document["report"]).read_text().startswith("<!DOCTYPE html>")
    machine.night.changed(**COLLISION)
    out = commands.run("verify")
    assert out.exit_code == 4
    assert "out of limits" in out.stderr
    assert "held-out positions" in out.stdout
    needed = commands.run("nightly")
    assert needed.exit_code == 4
    assert "a full calibration is needed" in needed.stderr
    assert commands.run("nightly", "--slot", "soon").exit_code == 2
    assert commands.run("verify", "--standing-at", "9").exit_code == 2
