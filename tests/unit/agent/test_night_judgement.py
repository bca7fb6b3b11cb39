"""Verdict on a machine at night, and the use that a night makes of its slot; minutes are counted by hand."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from agent.errors import GateRefused, MeasurementFault
from agent.execution.run_state import RunStateTracker
from agent.execution.states import RunState
from agent.execution.steps import MoveTo
from agent.results.run_outcome import Decision, NightReport
from agent.runs.kinds import drift_check, nightly
from agent.runs.kinds.drift_check import Judge, Judgement, with_fit
from agent.runs.kinds.full_calibration import Slot
from agent.runs.kinds.night_plan import NightPlan
from agent.runs.kinds.nightly import NightlyRun
from agent.runs.run_context import RunContext, RunHooks
from agent.settings.schema import NightlySettings
from drivers.clock import VirtualClock
from twin.artefact.position_set import Position
from twin.errors import DataError
from twin.identification import DriftFactor
from twin.monitoring.night_fit import NightFit
from twin.monitoring.step_detection import SuspectedJump

LIMITS = NightlySettings(max_chi2=2.0, max_ve_growth=1.5, step_evidence=8.0)
LAST_VE_UM = 4.0


def jump(error: str, evidence: float) -> SuspectedJump:
    return SuspectedJump(error, evidence, 2.0 * evidence, 3, 12.0, "µm", {f"{error}_1": 0.012})


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
        return one.judge_balls(3, [], [], lambda points: points)

    return judge


@pytest.mark.parametrize("fits", [True, False])
def test_a_fused_night_that_does_not_fit_is_reported_with_its_figures(fits: bool) -> None:
    report = NightReport(Decision.WITHIN, "run-7", 1.0, 1, 3)
    prior: Any = SimpleNamespace(drift_factor=DriftFactor(3.2, 0.2))
    found = with_fit(report, NightFit(prior, 0.8, 1.7, 2e-5, fits, None if fits else jump("EYX", 15.0)))
    assert (found.fit_probability, found.drift_factor) == (2e-5, 3.2)
    assert found.as_json()["warning"] == found.warning
    assert bool(found.warning) is not fits
    if not fits:
        for figure in ("χ² 1.70", "3.2 times as stated", "expected 0.8", "EYX changed by +12.0 µm"):
            assert figure in found.warning


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
        assert "EXX changed by +12.0 µm" in verdict.report.reason
        assert "EYX" not in verdict.report.reason
        assert [one.error for one in verdict.report.jumped] == ["EXX"]

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
            one.judge_balls(1, [], [], lambda points: points)


def position(number: int) -> Position:
    return Position(1, 10.0 * number, 0.0)


HELD, CHECKED = (position(0),), (position(1), position(2))
FURTHER = (position(3), position(4), position(5))
PLAN = NightPlan(1, HELD, CHECKED, FURTHER)
TIMELINE = {"look/a": 120.0, "look/b": 300.0, "further/a": 480.0, "further/b": 660.0, "publish/stage": 720.0}
"""The check ends after 5 min, the further positions after 11 min; the proof ends after 14 min."""
WHOLE_S = 840.0


class Journal:
    def __init__(self) -> None:
        self.decisions: list[tuple[str, Any]] = []

    def decision(self, kind: str, record: Any) -> None:
        self.decisions.append((kind, record))

    def state(self, *_: object, final: bool = False) -> None: ...


def report(reason: str = "") -> NightReport:
    decision = Decision.OUT if reason else Decision.WITHIN
    return NightReport(decision, "run-7", 1.0, 1, 3, reason=reason)


class Night(NightlyRun):
    """Night whose measurements take the given minutes and have the given verdicts, and which records its actions."""

    def __init__(
        self,
        verdicts: Sequence[str] = (),
        *,
        slot_minutes: float = 15.0,
        reserve: float = 0.5,
        full_allowed: bool = False,
        minutes: float = 5.0,
        full_minutes: float = 100.0,
    ) -> None:
        self.clock, self.journal = VirtualClock(), Journal()
        self.verdicts, self.minutes, self.full_minutes = list(verdicts), minutes, full_minutes
        self.done: list[tuple[str, tuple[Position, ...]]] = []
        self.fused: NightReport | None = None
        journal: Any = self.journal
        tracker = RunStateTracker(journal, lambda _: None)
        for state in (RunState.PREFLIGHT, RunState.MEASURING):
            tracker.enter(state)
        job: Any = SimpleNamespace()
        judge: Any = SimpleNamespace(reference=SimpleNamespace(), nights=1.0, job=None, prior=None)
        chooser: Any = SimpleNamespace(
            minutes=lambda positions: 2.0 * len(positions), discriminating=lambda *_, **__: ()
        )
        preflight: Any = SimpleNamespace(timeline=TIMELINE, machine_seconds=WHOLE_S)
        context: Any = RunContext(None, None, journal, tracker, None, self.clock, RunHooks())  # type: ignore[arg-type]
        super().__init__(job, context, judge, PLAN, chooser, preflight, Slot(slot_minutes, full_allowed, reserve))

    def _begin(self) -> Any: ...

    def _prepare_probe(self) -> Any: ...

    def _measure(self, prefix: str, positions: Sequence[Position], before: Any = None) -> Any:
        self.clock.sleep(60.0 * self.minutes)
        self.done.append((prefix, tuple(positions)))
        return prefix

    def _judged(self, measured: Any) -> Judgement:
        reason = self.verdicts.pop(0) if self.verdicts else ""
        found: Any = StubInnovation(1.0, [])
        self.progress.night = report(reason)
        return Judgement(self.progress.night, found)

    def _minutes_of(self, job: Any, procedure: Any = None) -> float:
        return self.full_minutes

    def _fuse(self, measured: Any, report: NightReport) -> None:
        self.fused = report

    def later(self, minutes: float) -> Night:
        self.clock.sleep(60.0 * minutes)
        return self


@pytest.fixture(autouse=True)
def _elsewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    """The table that is active is the accepted one; measurements and jobs are names."""
    monkeypatch.setattr(nightly, "require_table_of", lambda *_: None)
    monkeypatch.setattr(nightly, "join_measured", lambda first, second: f"{first}+{second}")
    monkeypatch.setattr(nightly, "positions_in", lambda _: ())
    monkeypatch.setattr(nightly, "job_at_station", lambda *_: "the whole job")


class TestSlot:
    def test_a_night_within_limits_uses_the_rest_of_its_slot(self) -> None:
        night = Night()
        night._work()
        assert night.done == [("look", (*HELD, *CHECKED)), ("further", FURTHER)]
        assert night.fused is not None

    @pytest.mark.parametrize(
        ("slot_minutes", "count"),
        # 9 min are planned after the check, which has taken 5; each position less takes 2 min less.
        [(14.5, 3), (14.4, 2), (12.5, 2), (12.4, 1), (10.5, 1), (10.4, 0)],
    )
    def test_positions_that_no_longer_fit_are_left_out_with_the_last_first(
        self, slot_minutes: float, count: int
    ) -> None:
        night = Night(slot_minutes=slot_minutes)
        night._work()
        further = [positions for prefix, positions in night.done if prefix == "further"]
        assert further == ([FURTHER[:count]] if count else [])
        assert night.fused is not None

    def test_out_of_limits_after_the_further_positions_counts_too(self) -> None:
        night = Night(["", "χ² 3.00"])
        with pytest.raises(GateRefused, match=r"χ² 3\.00"):
            night._work()
        assert [prefix for prefix, _ in night.done] == ["look", "further"]
        assert night.fused is None


class TestOutOfLimits:
    def test_a_full_calibration_is_asked_for_and_recorded(self) -> None:
        night = Night(["EXX changed"])
        with pytest.raises(GateRefused, match="a full calibration is needed: EXX changed"):
            night._work()
        assert [prefix for prefix, _ in night.done] == ["look"]
        (first, record), (second, needed) = night.journal.decisions
        assert (first, record["decision"], record["reason"]) == ("night", "full calibration needed", "EXX changed")
        assert needed == {"reason": "EXX changed"}
        assert second != first

    @pytest.mark.parametrize(
        ("full_allowed", "full_minutes", "done"),
        # 5 of 15 min are used and half a minute is reserved: 9.5 min are left.
        [(True, 9.5, True), (True, 9.6, False), (False, 1.0, False)],
    )
    def test_a_full_calibration_needs_consent_and_time(
        self, monkeypatch: pytest.MonkeyPatch, full_allowed: bool, full_minutes: float, done: bool
    ) -> None:
        calibrated: list[Any] = []
        monkeypatch.setattr(nightly, "calibrate_in_full", lambda *arguments: calibrated.append(arguments))
        night = Night(["VE has grown"], full_allowed=full_allowed, full_minutes=full_minutes)
        if done:
            night._work()
            [(_, full, _, _, told)] = calibrated
            assert full == "the whole job"
            assert told.decision is Decision.FULL_DONE
        else:
            with pytest.raises(GateRefused):
                night._work()
            assert calibrated == []


class TestResumedNight:
    """`too_late`: in the middle of the check at 2 min, 3 of its 5 minutes remain."""

    @pytest.mark.parametrize(("passed", "late"), [(0.0, False), (11.5, False), (11.6, True), (14.6, True)])
    def test_the_rest_of_the_check_must_fit_into_the_slot(self, passed: float, late: bool) -> None:
        refusal = Night().later(passed).too_late(MoveTo("look/a", (0.0, 0.0, 0.0)))
        assert (refusal is not None) is late

    @pytest.mark.parametrize(("passed", "late"), [(14.4, False), (14.5, True), (20.0, True)])
    def test_after_the_check_any_time_left_will_do(self, passed: float, late: bool) -> None:
        refusal = Night().later(passed).too_late(MoveTo("further/a", (0.0, 0.0, 0.0)))
        assert (refusal is not None) is late

    def test_the_refusal_says_how_much_is_missing(self) -> None:
        refusal = Night().later(12.5).too_late(MoveTo("look/a", (0.0, 0.0, 0.0)))
        assert "2.0 min are left of its slot of 15 min" in str(refusal)
        assert "needs 3.0 min more" in str(refusal)

    def test_a_step_that_was_not_planned_needs_no_time(self) -> None:
        assert Night().later(14.0).too_late(MoveTo("recover/here", (0.0, 0.0, 0.0))) is None
