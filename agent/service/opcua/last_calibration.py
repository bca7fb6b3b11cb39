"""Results of the last calibrations, and whether the stylus is qualified, read from the journal."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, Final

from agent.errors import JournalFailed
from agent.execution.journal_reader import JournalReader, has_journal, open_journal
from agent.execution.stored_json import stored_json
from agent.probing.preparation import PREFIX
from agent.results.decision_kinds import PROBE
from agent.results.run_verdict import Look, RunVerdict, run_figures

CHECKS: Final = f"{PREFIX}/station-"
"""Beginning of the keys of the steps that check the probe; a run without checks may park the mounts before."""


@dataclass(frozen=True)
class CalibrationResult:
    """Result of a run that has ended and has stated a volumetric error. `ve_um` and `vce_um` are those of
    `agent.results.run_verdict.RunFigures`; `ended` is a UTC time. `probe_serial_number` is that of the settings with
    which the run was started, None if they do not name it."""

    run_id: str
    ended: datetime
    ve_um: float | None
    vce_um: float | None
    verdict: RunVerdict
    probe_serial_number: str | None


@dataclass(frozen=True)
class JournalResults:
    """Result of the last calibration in the journal, that of the last one whose verdict is good, and whether the stylus
    is qualified. Each is None if the journal does not say it."""

    last: CalibrationResult | None = None
    last_good: CalibrationResult | None = None
    stylus_qualified: bool | None = None


def journal_results(directory: Path) -> JournalResults:
    """Read the journal in `directory`. Raise JournalFailed or InputError if it cannot be read."""
    if not has_journal(directory):
        return JournalResults()
    with open_journal(directory, JournalFailed) as reader:
        last = last_good = None
        for result in _latest_results(reader):
            last = last or result
            if result.verdict.look is Look.GOOD:
                last_good = result
                break
        return JournalResults(last, last_good, _stylus_qualified(reader))


def _latest_results(reader: JournalReader) -> Iterator[CalibrationResult]:
    """Yield the results of the runs that have ended and have stated a volumetric error, the latest first."""
    for run in reader.latest_begun_runs():
        figures = run_figures(run.state, reader.decision_records(run.run))
        if run.ended is None or (figures.ve_um is None and figures.vce_um is None):
            continue
        verdict = figures.verdict(run.kind, run.state, ended=True)
        settings = stored_json(reader.settings_text(run.run))
        ended = datetime.fromisoformat(run.ended)
        yield CalibrationResult(
            run.run_id, ended, figures.ve_um, figures.vce_um, verdict, _probe_serial_number(settings)
        )


def _probe_serial_number(settings: dict[str, Any]) -> str | None:
    number = settings.get("opcua", {}).get("probe", {}).get("serial_number")
    return None if number is None else str(number)


def _stylus_qualified(reader: JournalReader) -> bool | None:
    """Return True if the latest run that has begun to check the probe has qualified the stylus, and None otherwise: the
    journal does not say what happened to the stylus since an older qualification, and a run records the results of its
    checks only once all of them have passed."""
    checked = reader.last_decision(PROBE)
    if checked is None or not checked.record.get("facts", {}).get("rings"):
        return None
    for run in reader.latest_started_runs():
        if run.run == checked.run:
            return True
        if reader.has_step_below(run.run, CHECKS):
            return None
    return None
