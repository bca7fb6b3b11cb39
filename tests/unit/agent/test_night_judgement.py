"""Verdict on a machine at night, and the use that a night makes of its slot; minutes are counted by hand."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from agent.errors import GateRefused, MeasurementFault, PlanRefused
from agent.execution.encoding import table_digest
from agent.execution.engine import Engine
from agent.execution.run_state import RunStateTracker
from agent.execution.states import RunState
from agent.execution.steps import Dwell, MoveTo, Plan, ReadActiveBank, ReadClock, ReadTable, RunPlan
from agent.execution.supervisor import Supervisor
from agent.planning.stand_ins import USUAL_STORE
from agent.probing.run_plan import MeasuredPositions, MeasuringOrder
from agent.reports.run_report import _night_rows
from agent.results.run_outcome import Decision, NightReport
from agent.runs.kinds import drift_check, nightly
from agent.runs.kinds.drift_check import Judge, Judgement, with_fit
from agent.runs.kinds.night_plan import NightPlan
from agent.runs.kinds.nightly import NightTask, night
from agent.runs.kinds.run_parts import PreparedRun
from agent.runs.kinds.slot import Slot, too_late
from agent.runs.reference_state import ReferenceState
from agent.runs.run_context import RunHooks, run_actions
from agent.runs.run_results import RunResults
from agent.settings.schema import NightlySettings
from drivers.clock import VirtualClock
from drivers.roles import TableImage
from twin.artefact.position_set import Position
from twin.errors import DataError
from twin.identification import DriftFactor
from twin.identification.jump import SuspectedJump
from twin.monitoring.constant_drift import FoundDrift, SuspectedDrift
from twin.monitoring.night_fit import NightFit
from twin.monitoring.step_detection import PossibleJump

LIMITS = NightlySettings(max_chi2=2.0, max_ve_growth=1.5, step_evidence=8.0)
LAST_VE_UM = 4.0


def jump(error: str, evidence: float) -> SuspectedJump:
    return SuspectedJump(error, evidence, 2.0 * evidence, 3, 12.0, "µm", {f"{error}_1": 0.012})


POSSIBLE = (PossibleJump(jump("EYX", 15.0), 0.9), PossibleJump(jump("C0Y", 13.0), 0.1))
DRIFT = FoundDrift(9.0, 2e-4, (SuspectedDrift("EBX", 0.96, 0.8, 0.2, "µrad", 3e-5),))


class StubInnovation:
    """Innovation with given figures. `jumps`: errors that may have jumped, with their evidence."""

    posterior_mean, posterior_covariance = "mean", "covariance"

    def __init__(self, chi2: float, jumps: Sequence[SuspectedJump]) -> None:
        self.chi2_normalised = chi2
        self._jumps = sorted(jumps, key=lambda one: -one.evidence)

    def find_jumps(self, evidence: float) -> tuple[SuspectedJump, ...]:
        return tuple(one for one in self._jumps if one.evidence >= evidence)

    def suspects(self) -> list[SuspectedJump]:
        return self._jumps

    def possible_jumps(self) -> tuple[PossibleJump, ...]:
        return tuple(PossibleJump(one, 1.0 / len(self._jumps)) for one in self._jumps)


@pytest.fixture
def judged(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Judgement]:
    """Judge a night with these figures; the ball centres of three positions were measured."""

    def judge(chi2: float = 1.0, now_um: float = LAST_VE_UM, jumps: Sequence[SuspectedJump] = ()) -> Judgement:
        observations = SimpleNamespace(position=np.array([0, 0, 1, 1, 1, 2]))
        monkeypatch.setattr(drift_check, "observations_of", lambda *_: observations)
        monkeypatch.setattr(drift_check, "innovation", lambda *_: StubInnovation(chi2, jumps))
        monkeypatch.setattr(Judge, "_held_out", lambda *_: (3.0, 2.5))
        known = SimpleNamespace(z="known", z_covariance="covariance")
        reference: Any = SimpleNamespace(run_id="run-7", estimate=known, table=SimpleNamespace(written="written"))
        job: Any = SimpleNamespace(settings=SimpleNamespace(nightly=LIMITS), tool_offset_mm=None, artefact=None)

        def expected(mean: str, _: str, written: str) -> SimpleNamespace:
            assert written == "written"
            return SimpleNamespace(aligned_um={"known": LAST_VE_UM, "mean": now_um}[mean])

        one = Judge(job, reference, 2.0)
        vars(one).update(prior=known, family=None, residual_with_table=SimpleNamespace(of=expected))
        return one.judge_balls(3, [], [], lambda points: points, LIMITS.step_evidence)

    return judge


@pytest.mark.parametrize("fits", [True, False])
def test_a_fused_night_that_does_not_fit_is_reported_with_its_figures(fits: bool) -> None:
    report = NightReport(Decision.WITHIN, "run-7", 1.0, 1, 3)
    prior: Any = SimpleNamespace(drift_factor=DriftFactor(3.2, 0.2))
    found = with_fit(report, NightFit(prior, 0.8, 1.7, 2e-5, fits, () if fits else POSSIBLE, DRIFT))
    assert (found.fit_probability, found.drift_factor) == (2e-5, 3.2)
    assert found.as_json()["warning"] == found.warning
    assert bool(found.warning) is not fits
    if not fits:
        for figure in (
            "χ² 1.70",
            "3.2 times as stated",
            "expected 0.8",
            "EYX changed by +12.0 µm (90 %); or C0Y changed by +12.0 µm (10 %)",
        ):
            assert figure in found.warning
    drift: Any = found.as_json()["drift"]
    assert (drift["nights"], drift["false_alarm"], drift["suspects"]) == (9.0, 2e-4, [vars(DRIFT.suspects[0])])
    rows = dict(_night_rows(found.as_json()))
    assert rows["Drift in one direction"] == "for about 9 nights: EBX +0.8 ± 0.4 µrad a night (96 %)"  # k = 2
    assert DRIFT.text == "EBX by +0.8 ± 0.2 µrad a night for about 9 nights (96 %)"


class TestVerdict:
    def test_a_machine_as_expected_is_within_limits(self, judged: Callable[..., Judgement]) -> None:
        verdict = judged()
        report = verdict.report
        assert verdict.within
        assert (report.decision, report.reason) == (Decision.WITHIN, "")
        assert (report.since, report.nights, report.station, report.positions) == ("run-7", 2.0, 3, 3)
        assert (report.ve_before_um, report.ve_now_um) == (LAST_VE_UM, LAST_VE_UM)
        assert (report.held_out_um, report.held_out_predicted_um) == (3.0, 2.5)

    @pytest.mark.parametrize(("chi2", "within"), [(1.99, True), (2.0, True), (2.01, False)])
    def test_chi2_may_reach_its_limit(self, judged: Callable[..., Judgement], chi2: float, within: bool) -> None:
        verdict = judged(chi2=chi2)
        assert verdict.within is within
        assert ("χ² 2.01, allowed 2.00" in verdict.report.reason) is not within

    @pytest.mark.parametrize(("now_um", "within"), [(2.0, True), (6.0, True), (6.02, False)])
    def test_the_volumetric_error_may_grow_by_its_factor(
        self, judged: Callable[..., Judgement], now_um: float, within: bool
    ) -> None:
        # 1.5 times 4 µm is 6 µm.
        verdict = judged(now_um=now_um)
        assert verdict.within is within
        assert verdict.report.decision is (Decision.WITHIN if within else Decision.OUT)

    def test_a_jump_with_enough_evidence_is_named(self, judged: Callable[..., Judgement]) -> None:
        verdict = judged(jumps=[jump("EYX", 7.9), jump("EXX", 8.0)])
        assert not verdict.within
        reason, alternatives = verdict.report.reason.split(" (", maxsplit=1)
        assert "EXX changed by +12.0 µm" in reason
        assert "EYX" not in reason
        assert "EYX changed by +12.0 µm (50 %)" in alternatives
        assert [one.error for one in verdict.report.jumped] == ["EXX"]
        rows = dict(_night_rows(verdict.report.as_json()))
        assert rows["If one error changed"] == "EXX +12.0 µm (50 %); or EYX +12.0 µm (50 %)"

    def test_suspects_below_the_evidence_are_reported_and_change_nothing(
        self, judged: Callable[..., Judgement]
    ) -> None:
        names = ["EXX", "EYX", "EZX", "EAX", "EBX", "ECX"]
        verdict = judged(jumps=[jump(name, 7.0 - number) for number, name in enumerate(names)])
        assert verdict.within
        assert [one.error for one in verdict.report.likeliest] == names[:5]

    def test_every_reason_is_given(self, judged: Callable[..., Judgement]) -> None:
        reason = judged(chi2=3.0, now_um=8.0, jumps=[jump("B0Z", 20.0)]).report.reason
        assert [part.split(",")[0].split(" ")[0] for part in reason.split("; ")] == ["the", "ball", "VE"]
        assert "VE is 2.00 times that of the last night, allowed 1.50" in reason

    def test_too_few_balls_are_a_fault_of_the_measurement(
        self, judged: Callable[..., Judgement], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def fails(*_: object) -> None:
            raise DataError("no ball of the night is known")

        judged()
        one = Judge(SimpleNamespace(tool_offset_mm=None), SimpleNamespace(), 1.0)  # type: ignore[arg-type]
        monkeypatch.setattr(drift_check, "observations_of", fails)
        with pytest.raises(MeasurementFault, match="no ball of the night"):
            one.judge_balls(1, [], [], lambda points: points, LIMITS.step_evidence)


def position(number: int) -> Position:
    return Position(1, 10.0 * number, 0.0)


HELD, CHECKED = (position(0),), (position(1), position(2))
FURTHER = (position(3), position(4), position(5))
PLAN = NightPlan(1, HELD, CHECKED, FURTHER)
TIMELINE = {"look/a": 120.0, "look/b": 300.0, "further/a": 480.0, "further/b": 660.0, "publish/stage": 720.0}
"""The check ends after 5 min, the further positions after 11 min; the proof ends after 14 min."""
WHOLE_S = 840.0


TIMETABLE: Any = SimpleNamespace(timeline=TIMELINE, machine_seconds=WHOLE_S)
WHOLE_JOB: Any = "the whole job"


class Journal:
    run = 1

    def __init__(self) -> None:
        self.decisions: list[tuple[str, Any]] = []

    def decision(self, kind: str, record: Any) -> None:
        self.decisions.append((kind, record))

    def state(self, *_: object, final: bool = False) -> None: ...

    def table(self, *_: object) -> None: ...


@dataclass(frozen=True)
class StubJob:
    """Job of which only the positions count."""

    positions: tuple[Position, ...] = ()
    layout: Any = None


def report(reason: str = "") -> NightReport:
    decision = Decision.OUT if reason else Decision.WITHIN
    return NightReport(decision, "run-7", 1.0, 1, 3, reason=reason)


class Night:
    """Night whose measurements take the given minutes and have the given verdicts, and which records its actions.

    No compensation is active. `accepted`: the checksum of the table accepted in the last night. `suspected`: positions
    that discriminate between the suspected errors. `proved`: what was proved before it was measured. `full_minutes` and
    `other_minutes`: the times that a preflight finds for a full calibration and for other plans.
    """

    def __init__(
        self,
        verdicts: Sequence[str] = (),
        *,
        slot_minutes: float = 15.0,
        reserve: float = 0.5,
        full_allowed: bool = False,
        minutes: float = 5.0,
        full_minutes: float = 100.0,
        other_minutes: Callable[[int], float] = float,
        suspected: tuple[Position, ...] = (),
        accepted: int = 0,
    ) -> None:
        self.clock, self.journal, self.results = VirtualClock(), Journal(), RunResults()
        self.clock.sleep(1000.0)  # the slot begins with the night, whatever the clock shows
        self.verdicts, self.minutes, self.full_minutes = list(verdicts), minutes, full_minutes
        self.other_minutes = other_minutes
        self.done: list[tuple[str, tuple[Position, ...]]] = []
        self.proved: list[tuple[str, tuple[Position, ...]]] = []
        self.judged: list[tuple[str, ...]] = []
        self.calibrated: list[tuple[Any, NightReport]] = []
        self.fused: NightReport | None = None
        accepted_table: Any = SimpleNamespace(crc32=accepted)
        reference = ReferenceState("run-7", "2026-11-30T02:00:00Z", accepted_table, estimate=cast(Any, None))
        judge: Any = SimpleNamespace(reference=reference, nights=1.0, job=None, prior=None)
        chooser: Any = SimpleNamespace(
            minutes=lambda positions: 2.0 * len(positions), discriminating=lambda *_, **__: suspected
        )
        job: Any = StubJob()
        self.task = NightTask(job, judge, PLAN, chooser, Slot(slot_minutes, reserve, full_allowed), USUAL_STORE)
        self.tracker = RunStateTracker(self.recorder, lambda _: None)

    @property
    def recorder(self) -> Any:
        return self.journal

    def work(self) -> None:
        """Carry out the plan of the night, with the actions of a run."""
        actions = {
            ReadClock: lambda _: self.clock.now(),
            Dwell: lambda step: self.clock.sleep(step.duration_s),
            ReadActiveBank: lambda _: 0,
            ReadTable: lambda _: None,
        }
        machine = SimpleNamespace(position=lambda: np.array([1.0, 2.0, 3.0]))
        rig: Any = SimpleNamespace(actions=lambda _: actions, machine=machine)
        supervisor = Supervisor(self.clock)
        carried_out = run_actions(rig, self.recorder, self.tracker, supervisor, RunHooks())
        self.tracker.enter(RunState.PREFLIGHT)
        Engine(carried_out, None, self.results.observe).carry_out(night(self.task, lambda: TIMETABLE))

    def stubs(self) -> Mapping[str, Any]:
        """Return what replaces measurements and computations in the module of the night."""
        return {
            "check_measurement": self._check,
            "measure_positions": self._measure,
            "judge_measurement": self._judge,
            "run_preflight": self._prove,
            "calibrated_in_full": self._calibrate,
            "job_at_station": lambda *_: WHOLE_JOB,
            "_fused": self._fuse,
        }

    def _check(self, job: Any, plan: NightPlan, found: Any) -> Plan[tuple[PreparedRun, MeasuredPositions]]:
        prepared: Any = SimpleNamespace(rules=None)
        measured = yield from self._measure(plan.order("look", plan.first), None, None, None)
        return PreparedRun(job, found, prepared), measured

    def _measure(self, order: MeasuringOrder, _: Any, __: Any, ___: Any, ____: Any = ()) -> Plan[MeasuredPositions]:
        yield Dwell(f"{order.prefix}/measured", 60.0 * self.minutes)
        self.done.append((order.prefix, order.positions))
        return MeasuredPositions((), (order.prefix,), 0, order.standing_at, {})

    def _judge(self, _: Judge, plan: NightPlan, job: Any, measured: MeasuredPositions, __: Any) -> Judgement:
        self.judged.append(measured.left_out)
        found: Any = StubInnovation(1.0, [])
        return Judgement(report(self.verdicts.pop(0) if self.verdicts else ""), found)

    def _prove(
        self, job: Any, plan_of: Callable[[Any], RunPlan], at_mm: Any, watch: Any, *, every_branch: bool
    ) -> SimpleNamespace:
        """Walk the plan, which measures nothing yet. That of a full calibration consists of stand-ins and is not
        walked."""
        assert at_mm == (1.0, 2.0, 3.0)
        watch()
        if job is WHOLE_JOB:
            return SimpleNamespace(machine_minutes=self.full_minutes)
        done = len(self.done)
        for step in plan_of(job):
            assert isinstance(step, Dwell)
        [(prefix, positions)] = self.done[done:]
        del self.done[done:]
        self.proved.append((prefix, positions))
        return SimpleNamespace(machine_minutes=self.other_minutes(len(positions)))

    def _calibrate(self, job: Any, _: Any, __: Any, ___: Any, station: int, told: Callable[[], NightReport]) -> RunPlan:
        yield Dwell("full/calibrated", 60.0)
        assert station == PLAN.station
        self.calibrated.append((job, told()))
        return None

    def _fuse(self, _: Any, measured: Any, judgement: Callable[[], Judgement]) -> RunPlan:
        yield from ()
        self.fused = judgement().report
        return None


@pytest.fixture
def carried_out(monkeypatch: pytest.MonkeyPatch) -> Callable[[Night], Night]:
    """Carry out a night. Only its measurements and computations are replaced, none of its decisions."""

    def carry_out(one: Night) -> Night:
        for name, stub in one.stubs().items():
            monkeypatch.setattr(nightly, name, stub)
        one.work()
        return one

    return carry_out


Carried = Callable[[Night], Night]


class TestSlot:
    def test_a_night_within_limits_uses_the_rest_of_its_slot(self, carried_out: Carried) -> None:
        one = carried_out(Night())
        assert one.done == [("look", (*HELD, *CHECKED)), ("further", FURTHER)]
        assert one.judged == [("look",), ("look", "further")]
        assert one.proved == []  # the preflight of the night has walked it
        assert one.fused is not None

    @pytest.mark.parametrize(
        ("slot_minutes", "count"),
        # 9 min are planned after the check, which has taken 5; each position less takes 2 min less.
        [(14.5, 3), (14.4, 2), (12.5, 2), (12.4, 1), (10.5, 1), (10.4, 0)],
    )
    def test_positions_that_no_longer_fit_are_left_out_with_the_last_first(
        self, carried_out: Carried, slot_minutes: float, count: int
    ) -> None:
        one = carried_out(Night(slot_minutes=slot_minutes))
        further = [positions for prefix, positions in one.done if prefix == "further"]
        assert further == ([FURTHER[:count]] if count else [])
        assert one.fused is not None
        # A plan that is not that of the preflight is proved before it is carried out.
        assert one.proved == ([("further", FURTHER[:count])] if 0 < count < len(FURTHER) else [])

    def test_out_of_limits_after_the_further_positions_counts_too(self, carried_out: Carried) -> None:
        one = Night(["", "χ² 3.00"])
        with pytest.raises(GateRefused, match=r"χ² 3\.00"):
            carried_out(one)
        assert [prefix for prefix, _ in one.done] == ["look", "further"]
        assert one.fused is None

    def test_nothing_is_measured_with_another_table_than_the_accepted_one(self, carried_out: Carried) -> None:
        one = Night(accepted=7)
        with pytest.raises(GateRefused, match="does not hold the table accepted in run run-7"):
            carried_out(one)
        assert one.done == []

    def test_the_accepted_corrections_at_other_places_are_another_table(self) -> None:
        accepted = TableImage((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 1e-4, np.ones((2, 2, 2, 3), dtype=np.int32))
        table: Any = SimpleNamespace(crc32=table_digest(accepted))
        reference = ReferenceState("run-7", "2026-11-30T02:00:00Z", table, cast(Any, None), accepted)
        assert reference.is_table(replace(accepted))
        assert not reference.is_table(replace(accepted, origin_mm=(500.0, 0.0, 0.0)))
        assert not reference.is_table(replace(accepted, step_mm=(1.0, 2.0, 1.0)))
        assert not reference.is_table(replace(accepted, resolution_mm=1e-3))
        assert not reference.is_table(None)


class TestOutOfLimits:
    def test_a_full_calibration_is_asked_for_and_recorded(self, carried_out: Carried) -> None:
        one = Night(["EXX changed"])
        with pytest.raises(GateRefused, match="a full calibration is needed: EXX changed"):
            carried_out(one)
        assert [prefix for prefix, _ in one.done] == ["look"]
        (first, record), (second, needed) = one.journal.decisions
        assert (first, record["decision"], record["reason"]) == ("night", "full calibration needed", "EXX changed")
        assert needed == {"reason": "EXX changed"}
        assert second != first
        assert one.results.night is not None
        assert one.results.night.decision is Decision.FULL_NEEDED
        assert one.tracker.state is RunState.IDENTIFYING

    @pytest.mark.parametrize(
        ("full_allowed", "full_minutes", "done"),
        # 5 of 15 min are used and half a minute is reserved: 9.5 min are left.
        [(True, 9.5, True), (True, 9.6, False), (False, 1.0, False)],
    )
    def test_a_full_calibration_needs_consent_and_time(
        self, carried_out: Carried, full_allowed: bool, full_minutes: float, done: bool
    ) -> None:
        one = Night(["VE has grown"], full_allowed=full_allowed, full_minutes=full_minutes)
        if done:
            carried_out(one)
            [(full, told)] = one.calibrated
            assert full is WHOLE_JOB
            assert (told.decision, told.reason) == (Decision.FULL_DONE, "VE has grown")
            assert one.journal.decisions == []
        else:
            with pytest.raises(GateRefused):
                carried_out(one)
            assert one.calibrated == []

    @pytest.mark.parametrize(
        ("minutes_each", "count"),
        # 9.5 min are left; positions that do not fit are left out with the last first.
        [(3.0, 3), (3.2, 2), (9.5, 1), (9.6, 0)],
    )
    def test_a_diagnosis_uses_the_rest_of_the_slot(self, carried_out: Carried, minutes_each: float, count: int) -> None:
        one = Night(["EXX or EYX"], suspected=FURTHER, other_minutes=lambda number: minutes_each * number)
        with pytest.raises(GateRefused, match="EXX or EYX"):
            carried_out(one)
        diagnosed = [positions for prefix, positions in one.done if prefix == "diagnosis"]
        assert diagnosed == ([FURTHER[:count]] if count else [])
        assert [len(positions) for _, positions in one.proved] == list(range(3, max(count, 1) - 1, -1))
        # The second look finds nothing; the reason of the first one stays.
        assert one.results.night is not None
        assert (one.results.night.decision, one.results.night.reason) == (Decision.FULL_NEEDED, "EXX or EYX")


def later(passed_minutes: float, following: str) -> PlanRefused | None:
    slot = Slot(15.0, full_allowed=False, reserve=0.5)
    return too_late(slot, TIMETABLE, MoveTo(following, (0.0, 0.0, 0.0)), passed_minutes)


class TestResumedNight:
    """`too_late`: in the middle of the check at 2 min, 3 of its 5 minutes remain."""

    @pytest.mark.parametrize(("passed", "late"), [(0.0, False), (11.5, False), (11.6, True), (14.6, True)])
    def test_the_rest_of_the_check_must_fit_into_the_slot(self, passed: float, late: bool) -> None:
        assert (later(passed, "look/a") is not None) is late

    @pytest.mark.parametrize(("passed", "late"), [(14.4, False), (14.5, True), (20.0, True)])
    def test_after_the_check_any_time_left_will_do(self, passed: float, late: bool) -> None:
        assert (later(passed, "further/a") is not None) is late

    def test_the_refusal_says_how_much_is_missing(self) -> None:
        refusal = later(12.5, "look/a")
        assert "2.0 min are left of its slot of 15 min" in str(refusal)
        assert "needs 3.0 min more" in str(refusal)

    def test_a_step_that_was_not_planned_needs_no_time(self) -> None:
        assert later(14.0, "recover/here") is None
