"""Result of the last calibration, and whether the stylus is qualified, read from the journal."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from agent.errors import JournalFailed
from agent.execution.journal_reader import has_journal, open_journal
from agent.results.decision_kinds import PROBE
from agent.results.run_verdict import RunVerdict, run_figures, verdict_of


@dataclass(frozen=True)
class CalibrationResult:
    """Result of a run that has ended and has stated a volumetric error. `ve_um` and `vce_um` are those of
    `agent.results.run_verdict.RunFigures`; `ended` is a UTC time."""

    run_id: str
    ended: datetime
    ve_um: float | None
    vce_um: float | None
    verdict: RunVerdict


def last_calibration(directory: Path) -> CalibrationResult | None:
    """Return the result of the latest run of the journal in `directory` that has ended and has stated a volumetric
    error, or None if there is none. Raise JournalFailed if the journal cannot be read."""
    if not has_journal(directory):
        return None
    with open_journal(directory, JournalFailed) as reader:
        for run in reader.latest_begun_runs():
            figures = run_figures(reader.decision_records(run.run))
            if run.ended is not None and (figures.ve_um is not None or figures.vce_um is not None):
                verdict = verdict_of(
                    run.kind, run.state, ended=True, accepted=figures.accepted, decision=figures.decision
                )
                return CalibrationResult(
                    run.run_id, datetime.fromisoformat(run.ended), figures.ve_um, figures.vce_um, verdict
                )
    return None


def stylus_qualified(directory: Path) -> bool | None:
    """Return True if the latest run of the journal in `directory` that has checked the probe has qualified the stylus,
    and None otherwise: the journal does not say what happened to the stylus since an older qualification. Raise
    JournalFailed if the journal cannot be read."""
    if not has_journal(directory):
        return None
    with open_journal(directory, JournalFailed) as reader:
        checked = reader.last_decision(PROBE)
        facts = {} if checked is None else checked.record.get("facts", {})
        return True if facts.get("rings") else None
