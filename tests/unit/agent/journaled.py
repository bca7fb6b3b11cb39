"""Journals of runs that never were: what history and reports read, written as a run writes it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from journal_surgery import change_dates

from agent.execution.journal import Journal
from agent.execution.states import RunState
from drivers.clock import VirtualClock

CONFIG = Path(__file__).resolve().parents[3] / "config"
SETTINGS: dict[str, Any] = {
    "machine": str(CONFIG / "machines" / "case-study.toml"),
    "artefact": str(CONFIG / "artefacts" / "ball-bar-1500.toml"),
    "tool": "probe",
    "procedure": {"position_set": "S3", "touches_per_ball": 5},
    "identification": {"prior": True, "weights": "full"},
}


def run_id(night: int) -> str:
    return f"202611{night + 1:02d}T020000Z-0000"


def journaled(
    state: Path,
    night: int,
    exx_um: float = 3.0,
    *,
    machine: str | None = None,
    ve_um: float = 10.0,
    ends: RunState = RunState.COMPLETE,
) -> str:
    """Write a calibration of the case study with `exx_um` as EXX[1] and EXX[2] nought, 02:00 of that night's day."""
    journal = Journal(state)
    try:
        settings = {**SETTINGS, "history": {"machine": machine}}
        run = journal.start_run(run_id(night), "calibrate", settings, "1.2.3", VirtualClock())
        volumetric = {"value_um": ve_um, "standard_uncertainty_um": 0.5}
        run.decision("identified", {"volumetric": {"before_aligned": volumetric, "after_aligned": volumetric}})
        run.decision("gate", {"name": "fit", "passed": True, "value": 1.0, "limit": 2.0, "text": "fits"})
        run.decision("proof", proof(accepted=True))
        run.estimate(json.dumps(estimate(exx_um)))
        run.decision("outcome", {"machine_minutes": 83.5, "predicted_minutes": 84.0, "table_bank": 1, "night": None})
        for step in (RunState.PREFLIGHT, RunState.MEASURING):
            run.state(step)
        run.state(ends, "as it should", final=True)
    finally:
        journal.close()
    dated(state, night)
    return run_id(night)


def dated(state: Path, night: int) -> None:
    """As if it had been that night."""
    day = f"2026-11-{night + 1:02d}T"
    change_dates(state, run_id(night), f"{day}02:00:00.000Z", f"{day}03:30:00.000Z")


def proof(*, accepted: bool) -> Mapping[str, Any]:
    return {
        "accepted": accepted,
        "before_um": 3.5,
        "after_um": 2.5,
        "predicted_um": 2.4,
        "chi2_normalised": 1.1,
        "change": 0.98,
        "gain": 0.9,
        "limit": 0.2,
        "reason": "better than before and as predicted",
    }


def estimate(exx_um: float) -> Mapping[str, Any]:
    return {
        "rank": 2,
        "chi2_normalised": 1.05,
        "parameters": [
            {"name": "EXX[1]", "value": 1e-3 * exx_um, "standard_uncertainty": 1e-3, "unit": "mm"},
            {"name": "EXX[2]", "value": 0.0, "standard_uncertainty": 1e-3, "unit": "mm"},
            {"name": "A0Z", "value": 2e-6, "standard_uncertainty": 1e-6, "unit": "rad"},
        ],
    }
