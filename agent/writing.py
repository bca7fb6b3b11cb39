"""The files a run leaves: ball centres, estimate, table, report; each complete or not there."""

from __future__ import annotations

from dataclasses import replace
from importlib.metadata import version

import numpy as np

from agent.execution.journal import RunJournal
from agent.files import write_all_atomically
from agent.findings import Finding, order_text, provenance, scale_warnings
from agent.guarded_run import Progress
from agent.job import Job
from agent.outcome import Outcome, Proof
from agent.probe_facts import probe_facts
from agent.report import (
    EventLine,
    Header,
    Quantity,
    ReportData,
    RunFacts,
    TemperatureTrace,
    Verification,
    name_of_positions,
    render_report,
)
from drivers.clock import utc_timestamp
from twin.formats.ball_file import format_balls
from twin.formats.estimate_file import format_estimate
from twin.formats.table_file import checksum, format_side_file, format_table
from twin.position_set import Position

TITLES = {"calibrate": "Calibration", "nightly": "Night"}


def write_results(job: Job, outcome: Outcome, progress: Progress, journal: RunJournal) -> Outcome:
    """Write what there is under ``STATE/RUN_ID`` and return the outcome with the report's path.

    A run that did not come to an estimate leaves its measurements in the journal and no files.
    """
    finding, measured = progress.finding, progress.measured
    if finding is None or measured is None:
        return outcome
    directory = job.settings.state_directory / outcome.run_id
    positions = _positions(job, progress)
    table = format_table(finding.table)
    texts = {
        "balls.csv": format_balls(finding.observations, positions, [job.settings.tool]),
        "estimate.json": format_estimate(finding.estimate, provenance(job, outcome.run_id)),
        "table.csv": table,
        "table.json": format_side_file(finding.table),
        "report.html": render_report(_report(job, outcome, progress, finding, journal, checksum(table))),
    }
    write_all_atomically(directory, texts)
    return replace(outcome, report=directory / "report.html")


def _positions(job: Job, progress: Progress) -> tuple[Position, ...]:
    """In the order of the observations' position numbers."""
    assert progress.measured is not None  # noqa: S101  checked by the only caller
    balls = job.balls_of(progress.measured, held_out=False)
    seen = dict.fromkeys((b.station, b.azimuth_deg, b.elevation_deg) for b in balls)
    return tuple(Position(*key) for key in seen)


def _report(
    job: Job, outcome: Outcome, progress: Progress, finding: Finding, journal: RunJournal, crc32: str
) -> ReportData:
    positions = _positions(job, progress)
    header = Header(
        title=TITLES.get(outcome.kind, "Calibration"),
        run_id=outcome.run_id,
        timestamp=utc_timestamp(),
        software_version=version("volcal"),
        state=outcome.state.value,
        position_set=name_of_positions(positions),
        settings={
            "Prior": "family of the machine" if job.settings.identification.prior else "none",
            "Weights": "full covariances" if job.settings.identification.weights == "full" else "all alike",
            "Legendre order": order_text(finding.estimate),
            "Touches a ball": str(job.settings.procedure.touches_per_ball),
        },
    )
    return ReportData(
        header=header,
        machine=job.machine,
        artefact=job.artefact,
        observations=finding.observations,
        estimate=finding.estimate,
        positions=positions,
        tool_name=job.settings.tool,
        table=finding.table,
        table_crc32=crc32,
        volumetric=finding.volumetric,
        gates=tuple(progress.gates),
        warnings=_warnings(finding, outcome, progress),
        run=RunFacts(
            touches=outcome.touches,
            machine_minutes=outcome.machine_minutes,
            table_bank="not known" if outcome.table_bank is None else str(outcome.table_bank),
            verification=_verification(outcome.proof),
            probe=probe_facts(progress.prepared),
            temperatures=_temperatures(journal),
            events=tuple(EventLine(*row) for row in journal.event_lines()),
        ),
    )


def _verification(proof: Proof | None) -> Verification | None:
    if proof is None:
        return None
    verdict = f"{proof.reason}; normalised χ² {proof.chi2_normalised:.2f}"
    return Verification(
        proof.accepted, verdict, Quantity(proof.before_um), Quantity(proof.after_um), proof.predicted_um
    )


def _temperatures(journal: RunJournal) -> tuple[TemperatureTrace, ...]:
    history = journal.temperature_history()
    names = sorted({name for _, values in history for name in values})
    traces = []
    for name in names:
        rows = [(minutes, values[name]) for minutes, values in history if name in values]
        minutes, values = np.array(rows).T
        traces.append(TemperatureTrace(name, minutes, values))
    return tuple(traces)


def _warnings(finding: Finding, outcome: Outcome, progress: Progress) -> tuple[str, ...]:
    prepared = progress.prepared
    notes = list(prepared.reversal.warnings) if prepared is not None and prepared.reversal is not None else []
    share = float(np.mean(finding.table.extrapolated))
    if share > 0.0:
        notes.append(f"{100.0 * share:.0f} % of the table's nodes lie outside the measured region.")
    if outcome.proof is None:
        notes.append("Nothing was measured with the table active: what is said about the time after is a prediction.")
    return (*notes, *scale_warnings(finding.estimate))
