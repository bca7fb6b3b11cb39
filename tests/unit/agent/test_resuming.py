"""Parts of a resume: records read from the journal, their comparison with the plan, and the return of the machine."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from service_house import CONFIG, house, settings_document

from agent.cli.run_commands.resume import resume_command
from agent.errors import Aborted, PlanDiverged
from agent.execution.encoding import decode_result, encode_result, table_digest
from agent.execution.engine import Action
from agent.execution.journal import Journal, RunJournal
from agent.execution.journal_reader import open_journal
from agent.execution.replay_log import ReplayLog
from agent.execution.rig import step_tag
from agent.execution.run_state import Announcement, RunStateTracker
from agent.execution.states import RunState
from agent.execution.steps import (
    ActivateBank,
    MoveTo,
    OrientTo,
    ReadPosition,
    ReadTable,
    ReadTemperatures,
    Record,
    Step,
    TouchTowards,
)
from agent.results.decision_kinds import INPUTS
from agent.runs.other_machine import require_own_state_directory
from agent.runs.reconcile_result import CompensationState, ReconcileAction, Reconciliation
from agent.runs.resume.replay_clock import ResumedClock
from agent.runs.resume.replay_engine import Replay, ReplayingEngine
from agent.runs.resume.step_trace import StepTrace
from agent.runs.run_request import RunRequest
from agent.runs.unfinished_run import unfinished_run
from agent.settings.schema import Settings
from drivers.clock import VirtualClock
from drivers.errors import (
    CommandRejected,
    ConfigurationError,
    DeadlineExpired,
    GuardTripped,
    InputError,
    LinkError,
    LinkLost,
    MotionFault,
    StoreError,
    VolcalError,
)
from drivers.links.modbus_transport import DamagedFrame
from drivers.roles import Miss, Orientation, TableImage, Touch

TABLE = TableImage((0.0, 0.1, 0.2), (1.0, 2.0, 3.0), 1e-4, np.arange(24, dtype=np.int32).reshape(2, 2, 2, 3))
THIRD = 1.0 / 3.0


@pytest.fixture
def journal(tmp_path: Path):
    opened = Journal(tmp_path)
    yield opened
    opened.close()


class LinkOfAPlugin(LinkError):
    """Error that the driver of a third party raises."""


def begun(journal: Journal) -> RunJournal:
    run = journal.start_run("run-1", "calibrate", {}, "0", VirtualClock())
    run.origin({"kind": "calibrate"})
    run.begun()
    return run


@pytest.mark.parametrize("error", [DamagedFrame("an answer that does not fit"), LinkOfAPlugin("no carrier")])
def test_a_special_error_of_a_link_is_recorded_as_what_it_is(
    tmp_path: Path, journal: Journal, error: VolcalError
) -> None:
    run = begun(journal)
    run.fail(MoveTo("measure/ball-04/touch-0/start", (0.0, 0.0, 0.0)), error)
    run.state(RunState.FAULTED, str(error), final=True)
    found = unfinished_run(tmp_path)
    assert found is not None
    assert found.resumable


@pytest.mark.parametrize(
    ("kind", "result"),
    [
        (TouchTowards, Touch((THIRD, -0.1, 1e-17))),
        (TouchTowards, Miss((1.0, 2.0, 3.0))),
        (OrientTo, Orientation(THIRD, -45.0)),
        (ReadPosition, (THIRD, 2.0, 3.0)),
        (ReadTemperatures, {"artefact": 20.1 + THIRD}),
        (MoveTo, None),
    ],
)
def test_every_result_is_read_back_with_all_its_bits(kind: type, result: object) -> None:
    assert decode_result(kind.__name__, encode_result(result)) == result


def test_a_table_is_found_by_its_digest_and_stored_completely(journal: Journal) -> None:
    run = begun(journal)
    run.table("backup", 1, TABLE)
    assert decode_result(ReadTable.__name__, encode_result(TABLE)) == {"shape": [2, 2, 2], "crc32": table_digest(TABLE)}
    kept = run.stored_table(table_digest(TABLE))
    assert kept is not None
    assert kept.same_as(TABLE)
    assert run.stored_table(1) is None


def test_entries_are_neither_written_twice_nor_changed(journal: Journal, tmp_path: Path) -> None:
    run = begun(journal)
    run.decision("gate", {"value": THIRD})
    run.aside().decision("restore/activated", {"bank": 1})
    again, _ = journal.continue_run(run.run, run.run_id, VirtualClock())
    again.decision("gate", {"value": THIRD})
    again.decision("proof", {"accepted": True})
    with open_journal(tmp_path) as reader:
        assert [one.kind for one in reader.decisions(1)] == ["gate", "restore/activated", "proof"]
        assert [one.kind for one in reader.decisions(1, procedure_only=True)] == ["gate", "proof"]
    other, _ = journal.continue_run(run.run, run.run_id, VirtualClock())
    with pytest.raises(PlanDiverged, match="same with other figures"):
        other.decision("gate", {"value": 0.3333333333333333 + 1e-16})


@pytest.mark.parametrize(
    ("run", "run_id", "refusal"),
    [(2, "run-1", "run run-1 under another number"), (1, "run-2", "the journal has no run run-2")],
)
def test_only_a_run_that_the_journal_has_is_continued(journal: Journal, run: int, run_id: str, refusal: str) -> None:
    begun(journal)
    with pytest.raises(InputError, match=refusal):
        journal.continue_run(run, run_id, VirtualClock())


def test_a_discarded_position_is_measured_again_from_its_turn_on(journal: Journal, tmp_path: Path) -> None:
    run = begun(journal)
    turn = OrientTo("measure/station-1/az0-el0/orient", 1, 0.0, 0.0)
    for step, result in (
        (OrientTo("measure/station-1/az9-el0/orient", 1, 9.0, 0.0), Orientation(9.0, 0.0)),
        (Record("measure/station-1/az9-el0/ball-00/centre", "ball", {"centre_mm": [0.0, 0.0, 0.0]}), None),
        (turn, Orientation(0.0, 0.0)),
        (Record("measure/station-1/az0-el0/ball-00/centre", "ball", {"centre_mm": [1.0, 0.0, 0.0]}), None),
        (Record("measure/station-1/az0-el0/ball-01/lost", "event", {"ball": 1}), None),
    ):
        if isinstance(step, OrientTo):
            run.begin(step)
        run.finish(step, result, begun=isinstance(step, OrientTo))
    assert run.discard_since(turn.key, "it has moved") == 1
    again, recorded = journal.continue_run(run.run, run.run_id, VirtualClock())
    assert [step.key for step in recorded.steps] == ["measure/station-1/az9-el0/orient"]
    assert [key for key, _ in recorded.entries["balls"]] == ["measure/station-1/az9-el0/ball-00/centre"]
    assert not recorded.entries["events"]
    again.begin(turn)
    with open_journal(tmp_path) as reader:
        [discarded] = reader.events(1, ("discarded",))
        assert reader.ordinal_of(1, turn.key) > 3
    assert discarded.record["record"] == {"centre_mm": [1.0, 0.0, 0.0]}


def replaying(journal: Journal, done: list[str], *, run: int = 1) -> ReplayingEngine:
    clock = ResumedClock(VirtualClock(), 0.0)
    run_journal, recorded = journal.continue_run(run, "run-1", clock)

    def touch(step: TouchTowards) -> Touch:
        done.append(step.key)
        return Touch((2.0, 0.0, 0.0))

    actions: dict[type, Action] = {
        MoveTo: lambda step: done.append(step.key),
        TouchTowards: touch,
        Record: lambda _: None,
    }
    return ReplayingEngine(actions, run_journal, None, Replay(recorded, clock, StepTrace()), lambda *_: TABLE)


def plan(second: str = "b"):
    yield MoveTo("a", (1.0, 0.0, 0.0))
    touch = yield TouchTowards(second, (3.0, 0.0, 0.0), 5.0)
    yield Record("found", "ball", {"centre_mm": list(touch.position_mm)})
    yield MoveTo("c", (1.0, 0.0, 0.0))
    return touch


def broken_at_c(journal: Journal) -> None:
    run = begun(journal)
    steps = plan()
    first = next(steps)
    run.begin(first)
    run.finish(first, None, begun=True)
    touch = steps.send(None)
    run.begin(touch)
    run.finish(touch, Touch((THIRD, 0.0, 0.0)), begun=True)
    run.finish(steps.send(Touch((THIRD, 0.0, 0.0))), None, begun=False)
    run.begin(steps.send(None))


def test_only_the_interrupted_step_is_carried_out(journal: Journal, tmp_path: Path) -> None:
    broken_at_c(journal)
    done: list[str] = []
    assert replaying(journal, done).run(plan()) == Touch((THIRD, 0.0, 0.0))
    assert done == ["c"]
    with open_journal(tmp_path) as reader:
        assert [ball.record for ball in reader.balls(1)] == [{"centre_mm": [THIRD, 0.0, 0.0]}]


def test_a_different_key_names_both_and_does_nothing(journal: Journal) -> None:
    broken_at_c(journal)
    done: list[str] = []
    with pytest.raises(PlanDiverged) as error:
        replaying(journal, done).run(plan(second="elsewhere"))
    assert (error.value.where["recorded"], error.value.where["asked"]) == ("b", "elsewhere")
    assert done == []


def test_other_figures_under_the_same_key_diverge_too(journal: Journal) -> None:
    broken_at_c(journal)

    def nearly():
        yield MoveTo("a", (1.0 + 1e-15, 0.0, 0.0))

    with pytest.raises(PlanDiverged, match="other figures"):
        replaying(journal, []).run(nearly())


def test_clock_gives_recorded_time_and_then_runs() -> None:
    inner = VirtualClock()
    inner.sleep(5.0)
    clock = ResumedClock(inner, 100.0)
    assert clock.now() == 100.0
    clock.advance_to(160.0)
    inner.sleep(3.0)
    assert clock.now() == 160.0
    clock.start_running(150.0)
    clock.sleep(2.0)
    assert clock.now() == 162.0
    clock.start_running(1e6)
    assert clock.now() == 162.0


def test_trace_has_the_approach_of_each_axis_and_a_point_short_of_the_touched_surface() -> None:
    trace = StepTrace()
    trace.add(ReadPosition("here"), (0.0, 0.0, 0.0))
    trace.add(MoveTo("far", (10.0, 0.0, 10.0)), None)
    trace.add(MoveTo("little", (10.3, 0.0, 10.0)), None)
    trace.add(MoveTo("back", (10.3, 0.0, 2.0)), None)
    x, y, z = trace.axes
    assert [(move.key, move.sign) for move in x] == [("far", 1.0), ("little", 1.0)]
    assert y == []
    assert [(move.key, move.sign, move.beside_mm) for move in z] == [("back", -1.0, 4.0)]
    trace.add(TouchTowards("touch", (30.3, 0.0, 2.0), 5.0), Touch((20.3, 0.0, 2.0)))
    assert trace.at_mm == (11.3, 0.0, 2.0)
    assert [move.key for move in trace.axes[0]] == ["touch"]


def test_replayed_states_are_not_announced(journal: Journal) -> None:
    run = begun(journal)
    first = RunStateTracker(run, lambda _: None)
    for state in (RunState.PREFLIGHT, RunState.MEASURING, RunState.HELD, RunState.MEASURING, RunState.IDENTIFYING):
        first.enter(state)
    heard: list[Announcement] = []
    again, recorded = journal.continue_run(run.run, run.run_id, VirtualClock())
    assert list(recorded.states) == [RunState.MEASURING, RunState.IDENTIFYING]
    tracker = RunStateTracker(again, heard.append, recorded.states)
    tracker.enter(RunState.RESUMING)
    tracker.enter(RunState.MEASURING)
    tracker.enter(RunState.IDENTIFYING)
    tracker.announce_again()
    tracker.enter(RunState.STAGING)
    assert [one.data["state"] for one in heard] == ["resuming", "identifying", "staging"]


@pytest.mark.parametrize(
    ("error", "resumable"),
    [
        (LinkLost("gone"), True),
        (MotionFault("emergency stop"), True),
        (DeadlineExpired("the override is at 0 %"), True),
        (GuardTripped("hit"), False),
        (CommandRejected("outside the travel"), False),
    ],
)
def test_only_faults_from_outside_can_be_resumed(journal: Journal, tmp_path: Path, error, resumable) -> None:
    run = begun(journal)
    step = MoveTo("a", (1.0, 0.0, 0.0))
    run.begin(step)
    run.fail(step, error)
    run.state(RunState.FAULTED, str(error), final=True)
    assert (unfinished_run(tmp_path) is not None) is resumable


@pytest.mark.parametrize(("before_return", "resumable"), [(True, True), (False, False)])
def test_an_error_before_the_return_leaves_a_run_resumable(
    journal: Journal, tmp_path: Path, before_return: bool, resumable: bool
) -> None:
    run = begun(journal)
    run.begin(TouchTowards("touch", (1.0, 0.0, 0.0), 5.0))
    run.state(RunState.MEASURING)
    run.state(RunState.RESUMING)
    run.fault(StoreError("the file of the bank is damaged"), before_return=before_return)
    run.state(RunState.FAULTED, "the file of the bank is damaged", final=True)
    assert (unfinished_run(tmp_path) is not None) is resumable


@pytest.mark.parametrize(
    ("error", "refusal"),
    [
        (LinkLost("gone"), ""),
        (GuardTripped("hit"), "it was ending after a fault with which no run goes on"),
        (Aborted("aborted: panel"), "it was aborting on request"),
    ],
)
def test_a_run_that_was_killed_while_it_ended_goes_on_after_a_fault_from_outside(
    journal: Journal, tmp_path: Path, error: VolcalError, refusal: str
) -> None:
    run = begun(journal)
    step = MoveTo("a", (1.0, 0.0, 0.0))
    run.begin(step)
    run.fail(step, error)
    run.state(RunState.ABORTING, str(error))
    found = unfinished_run(tmp_path)
    assert found is not None
    assert found.refusal == refusal


def test_a_run_refused_before_it_began_does_not_hide_an_interrupted_one(journal: Journal, tmp_path: Path) -> None:
    assert unfinished_run(tmp_path) is None
    run = begun(journal)
    run.begin(MoveTo("a", (1.0, 0.0, 0.0)))
    run.state(RunState.MEASURING)
    refused = journal.start_run("run-2", "calibrate", {}, "0", VirtualClock())
    refused.state(RunState.REFUSED, "no", final=True)
    found = unfinished_run(tmp_path)
    assert found is not None
    assert (found.run_id, found.last_step, found.resumable) == ("run-1", "a", True)
    run.state(RunState.ABORTING, "somebody")
    found = unfinished_run(tmp_path)
    assert found is not None
    assert not found.resumable


def test_an_interrupted_restoration_cannot_be_resumed(journal: Journal, tmp_path: Path) -> None:
    run = journal.start_run("run-1", "restore", {}, "0", VirtualClock())
    run.origin({})
    run.begun()
    run.begin(ActivateBank("restore-table/activate", 1))
    run.state(RunState.RESTORING)
    found = unfinished_run(tmp_path)
    assert found is not None
    assert "ask for the restoration again" in found.refusal


def later_run(journal: Journal, *steps: Step) -> RunJournal:
    """Begin a second run, which carries out `steps` and then loses a link."""
    run = journal.start_run("run-2", "calibrate", {}, "0", VirtualClock())
    run.origin({})
    run.begun()
    for step in steps:
        run.begin(step)
    run.fault(LinkLost("gone"))
    run.state(RunState.FAULTED, "gone", final=True)
    return run


def test_a_run_that_measured_nothing_leaves_the_interrupted_one_as_it_is(journal: Journal, tmp_path: Path) -> None:
    former = begun(journal)
    former.begin(TouchTowards("touch", (1.0, 0.0, 0.0), 5.0))
    former.state(RunState.MEASURING)
    later_run(journal, MoveTo("b", (1.0, 0.0, 0.0)), OrientTo("c", 1, 0.0, 0.0))
    found = unfinished_run(tmp_path)
    assert found is not None
    assert (found.run_id, found.resumable, found.state) == ("run-1", True, RunState.MEASURING)


@pytest.mark.parametrize("step", [TouchTowards("touch", (1.0, 0.0, 0.0), 5.0), ActivateBank("activate", 1)])
def test_a_run_that_measured_or_wrote_closes_the_interrupted_one(journal: Journal, tmp_path: Path, step: Step) -> None:
    former = begun(journal)
    former.begin(TouchTowards("touch", (1.0, 0.0, 0.0), 5.0))
    former.state(RunState.MEASURING)
    later_run(journal, step)
    found = unfinished_run(tmp_path)
    assert found is not None
    assert found.run_id == "run-2"
    with open_journal(tmp_path) as reader:
        row = reader.require_run("run-1")
    assert row.ended is not None
    assert (row.state, row.reason) == ("faulted", "interrupted, followed by run run-2")


def test_a_run_that_ended_before_it_measured_does_not_outlive_the_end_of_the_former(
    journal: Journal, tmp_path: Path
) -> None:
    former = begun(journal)
    former.begin(TouchTowards("touch", (1.0, 0.0, 0.0), 5.0))
    later_run(journal)
    again, _ = journal.continue_run(former.run, former.run_id, VirtualClock())
    again.begin(TouchTowards("further", (1.0, 0.0, 0.0), 5.0))
    again.state(RunState.COMPLETE, final=True)
    assert unfinished_run(tmp_path) is None


def test_a_tag_differs_between_runs_and_steps() -> None:
    """The tag is the CRC-32 of the register map, here computed bit by bit."""

    def crc32(data: bytes) -> int:
        value = 0xFFFFFFFF
        for byte in data:
            value ^= byte
            for _ in range(8):
                value = value >> 1 ^ (0xEDB88320 if value & 1 else 0)
        return value ^ 0xFFFFFFFF

    assert crc32(b"123456789") == 0xCBF43926
    assert step_tag(12, "measure/a") == crc32(b"12/measure/a")
    assert step_tag(1, "2/a") != step_tag(12, "a")


def test_an_empty_log_consumes_nothing() -> None:
    assert not ReplayLog().consume("decisions", "gate", "{}")


MILL = "case-study"
"""Name in the machine file of `settings_document`."""
FOLDERS = ("machines", "artefacts")


def settings_of(state: Path, /, **history: str) -> Settings:
    return Settings.model_validate(settings_document(state, history=history))


def interrupted_run_of(journal: Journal, machine: str, /, **history: str) -> RunJournal:
    run = journal.start_run("run-1", "calibrate", {"machine": "m.toml", "history": history}, "0", VirtualClock())
    run.decision(INPUTS, {"machine": machine})
    run.origin({"kind": "calibrate"})
    run.begun()
    run.begin(TouchTowards("touch", (1.0, 0.0, 0.0), 5.0))
    run.state(RunState.MEASURING)
    return run


def test_a_run_of_another_machine_that_can_be_resumed_is_protected(journal: Journal, tmp_path: Path) -> None:
    run = interrupted_run_of(journal, "lathe-3")
    with pytest.raises(ConfigurationError, match="run run-1 of another machine \\(lathe-3\\) is unfinished") as refused:
        require_own_state_directory(settings_of(tmp_path))
    assert refused.value.where["key"] == "state_directory"
    assert "former name" in refused.value.hint
    run.state(RunState.COMPLETE, final=True)
    require_own_state_directory(settings_of(tmp_path))


def test_an_unproved_table_of_another_machine_is_protected(journal: Journal, tmp_path: Path) -> None:
    run = interrupted_run_of(journal, "lathe-3")
    run.table("backup", 1, TABLE)
    run.table("staged", 2, TABLE)
    run.begin(ActivateBank("activate", 2))
    run.fault(GuardTripped("hit"))
    run.state(RunState.FAULTED, "hit; bank 1 could not be made active again", final=True)
    assert unfinished_run(tmp_path) is None
    with pytest.raises(ConfigurationError, match="a table of run run-1 of another machine"):
        require_own_state_directory(settings_of(tmp_path))
    run.table("restored", 1, TABLE)
    require_own_state_directory(settings_of(tmp_path))


@pytest.mark.parametrize(
    ("machine", "then", "now", "same"),
    [
        (MILL, {}, {}, True),
        (MILL, {}, {"machine": "mill-7"}, True),
        (MILL, {"machine": "mill-7"}, {}, True),
        (MILL, {"machine": "mill-7"}, {"machine": "mill-8"}, False),
        ("before the name was corrected", {"machine": "mill-7"}, {"machine": "mill-7"}, True),
        ("lathe-3", {"machine": "lathe-3"}, {}, False),
    ],
)
def test_a_machine_is_known_by_its_name_in_the_history_or_else_in_its_file(
    journal: Journal, tmp_path: Path, machine: str, then: dict[str, str], now: dict[str, str], same: bool
) -> None:
    interrupted_run_of(journal, machine, **then)
    with nullcontext() if same else pytest.raises(ConfigurationError):
        require_own_state_directory(settings_of(tmp_path, **now))


def test_a_run_of_which_no_machine_is_recorded_is_taken_as_one_of_this_machine(
    journal: Journal, tmp_path: Path
) -> None:
    require_own_state_directory(settings_of(tmp_path))
    begun(journal).begin(TouchTowards("touch", (1.0, 0.0, 0.0), 5.0))
    assert unfinished_run(tmp_path) is not None
    require_own_state_directory(settings_of(tmp_path))


def test_the_service_refuses_requests_that_would_end_a_run_of_another_machine(journal: Journal, tmp_path: Path) -> None:
    interrupted_run_of(journal, "lathe-3")
    with house(tmp_path) as built:
        owner = built.owner
        shown = Reconciliation(
            CompensationState.AS_EXPECTED, ReconcileAction.NOTHING, 1, unfinished=unfinished_run(tmp_path)
        )
        built.machine.found.append(shown)
        owner.reset()
        for request in (
            lambda: owner.start(RunRequest(kind="calibrate", source="page", consent=True)),
            lambda: owner.resume_run("page"),
            owner.give_up,
        ):
            with pytest.raises(ConfigurationError, match="of another machine"):
                request()
            assert not owner.busy
        assert built.machine.asked == ["reached"]


@pytest.mark.parametrize("options", [[], ["--give-up"], ["--restore"]])
def test_the_command_refuses_to_resume_or_settle_a_run_of_another_machine(
    journal: Journal, tmp_path: Path, options: list[str]
) -> None:
    interrupted_run_of(journal, "lathe-3")
    config = tmp_path / "volcal.toml"
    shipped = (CONFIG / "case-study.toml").read_text()
    for relative, absolute in (("../runs", tmp_path), *((f"{one}/", f"{CONFIG / one}/") for one in FOLDERS)):
        shipped = shipped.replace(f'"{relative}', f'"{absolute}')
    config.write_text(shipped)
    ended = CliRunner().invoke(resume_command, ["--config", str(config), *options])
    assert ended.exit_code == 2
    assert "of another machine" in ended.output
    found = unfinished_run(tmp_path)
    assert found is not None and found.resumable
