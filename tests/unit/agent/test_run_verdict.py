"""Each end of a run has one verdict and one set of figures, whoever shows them."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

import pytest
from journaled import SETTINGS, proof
from sqlalchemy import make_url

from agent.execution.journal import Journal
from agent.execution.run_record import read_record
from agent.execution.states import RunState
from agent.history.database_url import DatabaseAddress
from agent.history.export import as_csv, run_document
from agent.history.store import HistoryStore
from agent.history.sync import sync
from agent.reports.page.render import page_values
from agent.reports.page.texts import ENGLISH
from agent.reports.run_report import report_of
from agent.results.run_outcome import Decision
from agent.results.run_verdict import VERDICTS, Look, RunVerdict, verdict_of, verdict_words
from agent.service.state.archive import Archive
from drivers.clock import VirtualClock

INPUTS = {
    "machine": "case-study",
    "tools_mm": {"probe": [0.0, 0.0, -100.0]},
    "files": [],
    "artefact": {
        "name": "bar",
        "certificate": "none",
        "balls": 7,
        "ball_diameter_mm": 25.0,
        "reference_temperature_c": 20.0,
        "cte_per_k": 1e-6,
        "cte_standard_uncertainty_per_k": 1e-7,
    },
}
NIGHT_UM = dict.fromkeys(
    ("ve_before_um", "ve_now_um", "ve_after_um", "held_out_um", "held_out_predicted_um", "chi2_normalised"), 12.0
)


@dataclass(frozen=True)
class End:
    """End of a run as it stands in the journal. `proved` is the result of the proof; None if there was none."""

    verdict: str
    state: RunState = RunState.COMPLETE
    kind: str = "calibrate"
    proved: bool | None = None
    night: Decision | None = None
    outcome: Mapping[str, Any] = field(default_factory=dict)
    final: bool = True


CONFIRMED_END = {"confirmed": {"ve_kept_um": 11.0, "held_out_um": 4.0}}
ENDS = (
    End("accepted", proved=True),
    End("proof-failed", proved=False),
    End("confirmed", outcome=CONFIRMED_END),
    End("refused", RunState.REFUSED, outcome=CONFIRMED_END),
    End("refused", RunState.REFUSED),
    End("fused", kind="nightly", night=Decision.FUSED),
    End("accepted", kind="nightly", night=Decision.WRITTEN, proved=True),
    End("proof-failed", kind="nightly", night=Decision.RESTORED, proved=False),
    End("within-limits", kind="verify", night=Decision.WITHIN),
    End("out-of-limits", kind="verify", night=Decision.OUT),
    End("full-calibration-needed", RunState.REFUSED, kind="nightly", night=Decision.FULL_NEEDED),
    End("accepted", kind="nightly", night=Decision.FULL_DONE, proved=True),
    End("confirmed", kind="nightly", night=Decision.FULL_DONE, outcome=CONFIRMED_END),
    End("restored", kind="restore"),
    End("measured", kind="try"),
    End("aborted", RunState.ABORTED),
    End("aborted", RunState.ABORTED, proved=True),
    End("faulted", RunState.FAULTED, proved=True),
    End("written-not-active", RunState.WRITTEN, final=False),
    End("unfinished", RunState.MEASURING, final=False),
)
RUN = "20261101T020000Z-0000"


def written(state: Path, end: End) -> None:
    journal = Journal(state)
    try:
        settings = {**SETTINGS, "history": {"machine": None}, "verification": {"positions_deg": None}}
        run = journal.start_run(RUN, end.kind, settings, "1.2.3", VirtualClock())
        run.decision("inputs", INPUTS)
        night = None if end.night is None else night_document(end.night)
        if end.proved is not None:
            run.decision("proof", proof(accepted=end.proved))
        if end.final:
            figures = {"machine_minutes": 80.0, "estimated_ve_um": 30.0, "predicted_vce_um": 10.0}
            run.decision("outcome", {**figures, "night": night, **end.outcome})
        run.state(end.state, "as it was", final=end.final)
    finally:
        journal.close()


def database(directory: Path) -> DatabaseAddress:
    return DatabaseAddress(make_url(f"sqlite:///{directory / 'history.db'}"), "case-study", 60.0)


def night_document(decision: Decision) -> dict[str, Any]:
    lists: dict[str, Any] = {key: [] for key in ("jumped", "likeliest", "alternatives")}
    rest = {"since": RUN, "nights": 1.0, "station": 1, "positions": 2, "reason": "", "warning": "", "drift": None}
    return {"decision": decision.value, **rest, **lists, **NIGHT_UM, "finds": None}


@pytest.mark.parametrize("end", ENDS, ids=lambda end: f"{end.kind}-{end.verdict}")
def test_list_history_export_and_report_say_the_same(tmp_path: Path, end: End) -> None:
    state = tmp_path / "state"
    written(state, end)
    (listed,) = Archive(state, lambda run_id: state / run_id).runs(1)
    with closing(HistoryStore(database(tmp_path))) as store:
        sync(state, store)
        (stored,) = store.runs()
    record = read_record(state, RUN)
    values = page_values(report_of(record), ENGLISH)
    assert listed["verdict"] == stored.verdict.as_json() == run_document(stored)["verdict"]
    assert (listed["verdict"]["name"], values["sentence"]) == (end.verdict, listed["verdict"]["sentence"])
    assert values["state"] == listed["verdict"]["word"]
    assert end.verdict in as_csv([stored])
    figures = (stored.ve_before_um, stored.acting_um, stored.held_out_before_um, stored.held_out_after_um)
    assert tuple(listed[name] for name in ("ve_um", "vce_um", "held_out_before_um", "held_out_after_um")) == figures
    assert values["good"] == (listed["verdict"]["look"] in ("done", "quiet"))


def test_the_figure_with_table_is_that_of_the_table_which_is_active_at_the_end(tmp_path: Path) -> None:
    def vce(end: End, name: str) -> float | None:
        state = tmp_path / name
        written(state, end)
        (listed,) = Archive(state, lambda run_id: state / run_id).runs(1)
        found: float | None = listed["vce_um"]
        return found

    assert vce(End("accepted", proved=True), "accepted") == 10.0
    assert vce(End("proof-failed", proved=False), "failed") is None
    assert vce(End("faulted", RunState.FAULTED, proved=True), "taken back") is None
    assert vce(End("aborted", RunState.ABORTED, proved=True), "taken back by a person") is None
    assert vce(End("confirmed", outcome=CONFIRMED_END), "confirmed") == 11.0
    assert vce(End("proof-failed", kind="nightly", night=Decision.RESTORED, proved=False), "night") == 12.0


@pytest.mark.parametrize("state", RunState)
def test_nothing_but_success_is_green(state: RunState) -> None:
    kinds, decisions = ("calibrate", "nightly", "verify", "restore", "try"), (*(one.value for one in Decision), None)
    for kind, decision, accepted in product(kinds, decisions, (True, False, None)):
        found = verdict_of(kind, state.value, ended=True, accepted=accepted, decision=decision)
        if found.look is Look.GOOD:
            assert accepted is not False
            assert state not in (RunState.REFUSED, RunState.ABORTED, RunState.FAULTED, RunState.WRITTEN)
            assert accepted or decision not in ("out of limits", "full calibration needed", "former table restored")


def test_a_run_in_progress_is_not_unfinished(tmp_path: Path) -> None:
    written(tmp_path, End("unfinished", RunState.MEASURING, final=False))
    (listed,) = Archive(tmp_path, lambda run_id: tmp_path, lambda: RUN).runs(1)
    assert listed["verdict"]["name"] == "running"


@pytest.mark.parametrize("verdict", VERDICTS, ids=lambda verdict: verdict.name)
def test_each_verdict_has_its_words_in_both_languages(verdict: RunVerdict) -> None:
    words = verdict_words()
    for key in (f"verdict.{verdict.name}", f"verdict.{verdict.name}.is"):
        assert set(words[key]) == {"en", "de"}
        assert all(text.strip() for text in words[key].values())


def test_names_and_words_are_distinct() -> None:
    named = [(one.name, one.word["en"], one.word["de"]) for one in VERDICTS]
    assert [len(set(texts)) for texts in zip(*named, strict=True)] == [len(VERDICTS)] * 3


def test_a_decision_in_words_of_another_version_is_a_measurement() -> None:
    assert verdict_of("nightly", "complete", ended=True, accepted=None, decision="weighed").name == "measured"
