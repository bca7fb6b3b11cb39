"""Whole nights in one process: accepted, repeated on the compensated machine, restored, refused."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result
from nights import Night, document, short_document
from stored_run import StoredRun, repeated, stored_run

from agent.cli.main import main
from agent.cli.run_commands.local_run import conclude
from agent.execution.encoding import table_digest
from agent.execution.rig import Rig
from agent.execution.run_record import read_record
from agent.execution.states import RunState
from agent.execution.steps import STEPS_WITH_EFFECT
from agent.history.run_row import run_rows
from agent.planning.job_preparation import prepare_job
from agent.results.gates.gate_forecast import forecast_gates
from agent.runs.reference_state import read_reference
from agent.runs.run_context import RunHooks
from agent.runs.session import RunResult
from agent.settings.schema import Settings
from drivers.roles import TableImage
from twin.compensation.table_file import parse_table
from twin.formats.estimate_file import StoredEstimate, parse_estimate
from twin.machine.forward_model import deviation_basis
from twin.machine.volumetric import evaluation_grid, volumetric_error

ACTING_KINDS = {step.__name__ for step in STEPS_WITH_EFFECT}


@dataclass
class TwoNights:
    """The case study calibrated, and calibrated again with the first table active, by `volcal calibrate --json`."""

    night: Night
    state: Path
    first: RunResult
    second: Result
    after_first: tuple[int, dict[int, TableImage]]
    true_ve_um: tuple[float, float, float]

    @property
    def run_ids(self) -> tuple[str, str]:
        return self.first.outcome.run_id, str(self.confirmed["run_id"])

    @property
    def confirmed(self) -> dict[str, Any]:
        """Outcome of the second run, as the command printed it."""
        found: dict[str, Any] = json.loads(self.second.stdout)
        return found

    def stored(self, ended: RunResult) -> StoredRun:
        return stored_run(self.state, ended.outcome.run_id)

    def estimate(self, run_id: str) -> StoredEstimate:
        path = self.state / run_id / "estimate.json"
        return parse_estimate(path.read_text(), str(path))


@pytest.fixture(scope="module")
def nights() -> Iterator[TwoNights]:
    with TemporaryDirectory() as directory:
        state = Path(directory) / "state"
        night = Night()
        first = night.run(document(state))
        assert night.world is not None
        truth = night.world.truth
        found = (night.active, dict(night.banks))
        before, after = (truth.true_volumetric_error(bank)[1] for bank in (0, night.active))
        with pytest.MonkeyPatch.context() as patch:
            settings = Settings.model_validate(document(state))
            patch.setattr("agent.cli.run_commands.calibrate.load_settings", lambda _: settings)
            patch.setattr("agent.cli.run_commands.local_run.RunHooks", partial(RunHooks, devices=night.hooks.devices))
            second = CliRunner().invoke(main, ["calibrate", "--json", "--config", str(state.parent / "volcal.toml")])
        last = truth.true_volumetric_error(night.active)[1]
        yield TwoNights(night, state, first, second, found, (before, after, last))


def test_a_night_is_accepted_and_its_table_is_active(nights: TwoNights) -> None:
    assert nights.first.error is None
    outcome = nights.first.outcome
    assert outcome.state is RunState.COMPLETE
    assert outcome.proof is not None
    assert outcome.proof.accepted
    assert outcome.table_bank == nights.after_first[0] == 1
    conclude(nights.first)
    before, after, _ = nights.true_ve_um
    assert before > 11.0
    assert after < 3.9
    assert outcome.estimation is not None
    limits_um = outcome.estimation.volumetric.after_aligned.limits_um
    assert limits_um is not None
    assert limits_um[0] < after < limits_um[1]
    assert nights.night.world is not None
    assert nights.night.world.collisions == []


def test_every_gate_was_forecast_with_its_verdict_and_its_size(nights: TwoNights) -> None:
    job = prepare_job(Settings.model_validate(document(nights.state)), Path.cwd())
    forecast = {gate.gate: gate for gate in forecast_gates(job)}
    judged = {row.record["name"]: row.record for row in nights.stored(nights.first).decisions if row.kind == "gate"}
    assert set(forecast) - set(judged) == {"probe", "change", "night", "proof fit"}
    for name, record in judged.items():
        assert record["passed"] is forecast[name].passes, name
        assert forecast[name].expected is not None
    assert judged["redundancy"]["value"] == pytest.approx(forecast["redundancy"].expected, rel=0.05)
    assert judged["extrapolation"]["value"] == pytest.approx(forecast["extrapolation"].expected, abs=0.02)
    for name in ("fit", "gain", "proof", "certificate", "correction", "slope", "unmeasured"):
        assert 0.4 < judged[name]["value"] / (forecast[name].expected or 0.0) < 2.5, name


def test_active_bank_holds_the_table_of_the_files(nights: TwoNights) -> None:
    _, banks = nights.after_first
    folder = nights.state / nights.first.outcome.run_id
    assert sorted(path.name for path in folder.iterdir()) == [
        "artefact-covariance.csv",
        "artefact.toml",
        "balls.csv",
        "estimate.json",
        "report.html",
        "table.csv",
        "table.json",
    ]
    text, side = ((folder / name).read_text() for name in ("table.csv", "table.json"))
    table = parse_table(text, side, "table.csv", "table.json")
    assert np.abs(banks[1].counts * banks[1].resolution_mm - table.corrections).max() <= 0.5001 * banks[1].resolution_mm
    staged: list[Any] = nights.stored(nights.first).results("publish/read-back")
    assert [result["crc32"] for result in staged] == [table_digest(banks[1])]


def test_every_step_with_an_effect_began_before_it_ended_and_no_key_occurs_twice(nights: TwoNights) -> None:
    steps = nights.stored(nights.first).steps
    assert repeated(step.key for step in steps) == []
    assert {step.kind for step in steps} >= {"MoveTo", "TouchTowards", "OrientTo", "StageTable", "ActivateBank"}
    for step in steps:
        assert step.error is None, step.key
        assert step.finished_s is not None, step.key
        assert step.begun_s <= step.finished_s, step.key
        assert step.kind in ACTING_KINDS or step.begun_s == step.finished_s, step.key
    begins = [step.begun_s for step in steps]
    assert begins == sorted(begins)


def test_a_table_is_written_read_activated_and_asked_for_in_this_order(nights: TwoNights) -> None:
    writing = nights.stored(nights.first).steps_of("StageTable", "ReadTable", "ActivateBank", "ReadActiveBank")
    assert [step.key for step in writing] == [
        "before/active-bank",
        "before/active-table",
        "publish/stage",
        "publish/read-back",
        "activate/activate",
        "activate/active-bank",
    ]


def test_journal_stores_balls_backup_and_states(nights: TwoNights) -> None:
    run = nights.stored(nights.first)
    assert len({ball.key for ball in run.balls}) == len(run.balls) >= nights.first.outcome.balls
    backup, staged, *_ = run.tables
    assert (backup.role, backup.bank, backup.crc32) == ("backup", 0, None)
    assert (staged.role, staged.bank, staged.crc32) == ("staged", 1, table_digest(nights.after_first[1][1]))
    assert run.states == [
        "preflight", "measuring", "identifying", "staging", "activating", "verifying", "complete",
    ]  # fmt: skip


def test_second_night_sees_the_bare_machine_through_the_first_table(nights: TwoNights) -> None:
    one, two = (nights.estimate(run_id) for run_id in nights.run_ids)
    found = [
        dict(zip(run.model.names, zip(run.parameters, np.diag(run.covariance), strict=True), strict=True))
        for run in (one, two)
    ]
    common = found[0].keys() & found[1].keys()  # the evidence may choose different orders
    assert len(common) == min(one.model.size, two.model.size)
    for name in common:
        (first, variance), (second, other) = (parameters[name] for parameters in found)
        assert abs(second - first) <= 3.0 * np.sqrt(variance + other), name
    # Without the table added back, the second estimate would be of a machine with a quarter of the errors.
    assert np.linalg.norm(two.parameters) > 0.9 * np.linalg.norm(one.parameters)


def test_a_machine_that_is_still_good_is_confirmed_and_nothing_is_written(nights: TwoNights) -> None:
    assert nights.second.exit_code == 0, nights.second.output
    outcome = nights.confirmed
    confirmed = outcome["confirmed"]
    assert (outcome["state"], outcome["verified"], outcome["table_bank"]) == ("complete", None, 1)
    assert 0.75 * confirmed["ve_kept_um"] < confirmed["ve_new_um"] < confirmed["ve_kept_um"]
    assert nights.night.active == 1
    assert nights.night.banks.keys() == {1}
    assert nights.night.banks[1].same_as(nights.after_first[1][1])
    assert nights.true_ve_um[2] == nights.true_ve_um[1]
    run = stored_run(nights.state, outcome["run_id"])
    assert run.steps_of("StageTable", "ActivateBank") == []
    assert [(table.role, table.bank) for table in run.tables] == [("backup", 1)]
    assert str(run.row.reason).startswith("confirmed: ")
    assert "confirmed: the active compensation is kept" in Path(outcome["report"]).read_text()
    row = run_rows(read_record(nights.state, outcome["run_id"])).run
    assert (row["night"], row["accepted"], row["acting_um"]) == ("confirmed", None, confirmed["ve_kept_um"])


def test_later_nights_start_from_a_confirmed_run(nights: TwoNights) -> None:
    reference = read_reference(nights.state)
    assert reference is not None
    assert reference.run_id == nights.run_ids[1]
    assert reference.table.crc32 == table_digest(nights.night.banks[1])
    model, first = reference.estimate.model, nights.estimate(nights.run_ids[0])
    grid, offset = evaluation_grid(model.ranges_mm, (8, 6, 6)), first.tool_offsets[0]
    written = deviation_basis(model, grid, offset) @ reference.table.written
    table = deviation_basis(first.model, grid, offset) @ first.parameters
    left, whole = (volumetric_error(grid + offset, field).aligned_um for field in (written - table, table))
    assert left < 0.2 * whole  # what a lower order leaves of the table


class WrongSign:
    """A controller that subtracts what it should add, and reads back what was written."""

    def __init__(self, store) -> None:
        self._store = store

    def __getattr__(self, name: str):
        return getattr(self._store, name)

    def stage(self, bank: int, table: TableImage) -> None:
        self._store.stage(bank, dataclasses.replace(table, counts=-table.counts))

    def read_table(self, bank: int) -> TableImage | None:
        held = self._store.read_table(bank)
        return None if held is None else dataclasses.replace(held, counts=-held.counts)


class WithoutEffect:
    """A controller that stores and activates a table, reads back what was written, and corrects nothing."""

    part: Callable[[np.ndarray], np.ndarray] = staticmethod(np.zeros_like)

    def __init__(self, store) -> None:
        self._store = store
        self._held: dict[int, TableImage] = {}

    def __getattr__(self, name: str):
        return getattr(self._store, name)

    def stage(self, bank: int, table: TableImage) -> None:
        self._held[bank] = table
        self._store.stage(bank, dataclasses.replace(table, counts=self.part(table.counts)))

    def read_table(self, bank: int) -> TableImage | None:
        return self._held.get(bank, self._store.read_table(bank))


class HalfOfIt(WithoutEffect):
    """A controller that reads a table back as written, and adds half of it."""

    part = staticmethod(lambda counts: counts // 2)


@pytest.mark.parametrize(
    ("store", "mistake"),
    [
        (WrongSign, "the correction acts the wrong way: check the sign"),
        (WithoutEffect, "the table has no effect: the controller stores it"),
        (HalfOfIt, "half of each correction acts: check the unit"),
    ],
)
def test_a_table_that_is_applied_by_mistake_is_withdrawn_and_the_mistake_named(
    state: Path, store, mistake: str
) -> None:
    def wrong(rig: Rig) -> Rig:
        return dataclasses.replace(rig, store=store(rig.store))

    night = Night(tamper=wrong)
    ended = night.run(short_document(state), files=store is WrongSign)
    assert ended.error is None
    proof = ended.outcome.proof
    assert proof is not None
    assert not proof.accepted
    assert proof.after_um > 0.4 * proof.before_um
    assert proof.reason.startswith(mistake)
    assert "odds against the table as written: more than 1,000,000 to 1" in proof.reason
    assert night.active == 0
    assert ended.outcome.table_bank == 0
    run = stored_run(state)
    assert run.states[-2:] == ["restoring", "complete"]
    assert run.results("restore/active-bank") == [0]
    assert exit_code(ended) == 4
    if store is WrongSign:
        assert ended.outcome.report is not None
        assert "restored" in ended.outcome.report.read_text()


def test_a_table_that_no_proof_could_accept_is_not_written(monkeypatch, state: Path) -> None:
    night = Night()
    ended = night.run(short_document(state, verification={"max_chi2": 1e-6}), files=False)
    assert ended.outcome.proof is None
    assert "0.00" in str(ended.error)
    assert (night.active, night.banks) == (0, {})
    run = stored_run(state)
    assert run.steps_of("StageTable", "ActivateBank") == []
    assert run.row.state == "refused"
    assert exit_code(ended) == 4


def test_a_gain_that_the_held_out_positions_cannot_show_is_not_written(monkeypatch, state: Path) -> None:
    """The machine is much better than its family."""
    settings = short_document(state, verification={"min_gain": 0.0})
    settings["devices"]["twin"]["options"]["truth"]["scale"] = 0.3
    night = Night()
    ended = night.run(settings, files=False)
    assert ended.error is None
    conclude(ended)
    confirmed = ended.outcome.confirmed
    assert confirmed is not None
    assert confirmed.power is not None
    assert confirmed.power < 0.95
    assert confirmed.text.startswith("confirmed: the machine stays without a table; kept, no gain that can be shown")
    assert (night.active, night.banks, ended.outcome.proof) == (0, {}, None)
    reference = read_reference(state)
    assert reference is not None
    assert not reference.table.written.any()


def test_a_weak_set_ends_proved_or_confirmed_but_is_not_refused_for_its_gain(monkeypatch, state: Path) -> None:
    night = Night()
    ended = night.run(
        document(
            state,
            procedure={"position_set": "S2"},
            identification={"formulation": "distances"},
            verification={"stations": [4]},
        ),
        files=False,
    )
    assert ended.error is None
    conclude(ended)
    run, outcome = stored_run(state), ended.outcome
    gates = [decision.record for decision in run.decisions if decision.kind == "gate"]
    assert all(gate["passed"] for gate in gates)
    if outcome.confirmed is not None:
        assert run.steps_of("StageTable", "ActivateBank") == []
        assert (night.active, night.banks, outcome.proof) == (0, {}, None)
        return
    assert outcome.proof is not None
    assert outcome.proof.accepted
    assert outcome.proof.after_um < outcome.proof.before_um
    (gain,) = (gate for gate in gates if gate["name"] == "gain")
    assert gain["limit"] == 0.25 <= gain["value"]


def test_machine_without_error_is_left_alone(monkeypatch, state: Path) -> None:
    settings = short_document(state)
    settings["devices"]["twin"]["options"]["ideal"] = True
    night = Night()
    ended = night.run(settings, files=False)
    assert ended.error is None
    conclude(ended)
    assert ended.outcome.confirmed is not None
    assert (night.active, night.banks) == (0, {})
    reference = read_reference(state)
    assert reference is not None
    assert reference.table.crc32 == 0
    assert not reference.table.written.any()


def exit_code(ended: RunResult) -> int:
    with pytest.raises(SystemExit) as exit_:
        conclude(ended)
    return int(exit_.value.code or 0)
