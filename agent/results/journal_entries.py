"""Entries that a run makes in its journal in addition to its steps. With them, a report or a comparison of runs needs
only the journal.

The files that are named in the settings may be changed or deleted later. For this reason, the journal stores all data
of the machine, the artefact and the result that a report shows.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from agent.execution.journal import RunJournal
from agent.files import read_text, translated
from agent.planning.job import Job
from agent.probing.measured_balls import MeasuredBall
from agent.probing.preparation import PreparationResult
from agent.results.decision_kinds import HELD_OUT, IDENTIFIED, OUTCOME, PROBE
from agent.results.estimation import EstimationResult, order_text
from agent.results.facts import ArtefactFacts, TableFacts
from agent.results.observations import certified_balls, displayed_residuals
from agent.results.probe_facts import probe_facts
from agent.results.run_outcome import Outcome
from drivers.errors import ConfigurationError
from twin.artefact.artefact import Artefact
from twin.artefact.position_set import MIN_BALLS, Position
from twin.compensation.table_file import checksum, format_table
from twin.formats.toml_reading import parse_toml
from twin.units import UM_PER_MM

_NAMED_FILES = ("grid", "covariance_file")
"""Keys under which a machine file or an artefact file names another file."""


def inputs_of(job: Job) -> dict[str, Any]:
    """Return the data of the machine, the artefact and the input files at the start of a run, for the journal.

    Raises ConfigurationError if a file is missing.
    """
    return {
        "machine": job.machine.name,
        "tools_mm": {name: offset.tolist() for name, offset in job.machine.tools.items()},
        "artefact": asdict(ArtefactFacts.of(job.artefact)),
        "latencies_from": job.latencies_from,
        "stated_timing": (job.stated_timing or job.settings.timing).model_dump(mode="json"),
        "held_out": [[p.station, p.azimuth_deg, p.elevation_deg] for p in job.held_out],
        "files": [
            {"name": path.name, "sha256": sha256_of(path)}
            for path in input_files(job.settings.machine, job.settings.artefact)
        ],
    }


def record_probe(journal: RunJournal, prepared: PreparationResult) -> None:
    """Write the results of the checks of probe and stylus to the journal, in the form that a report shows."""
    facts = probe_facts(prepared)
    if facts is not None:
        checks = (prepared.latch, prepared.reversal)
        warnings = [warning for check in checks if check is not None for warning in check.warnings]
        journal.decision(PROBE, {"facts": asdict(facts), "warnings": warnings})


def record_identified(journal: RunJournal, balls: Sequence[MeasuredBall], estimation: EstimationResult) -> None:
    """Write to the journal the parts of an estimation that the estimate file does not contain.

    `balls` contains the measured balls in the order of the observations.
    """
    estimate = estimation.estimate
    positions = dict.fromkeys((ball.position, ball.station, ball.azimuth_deg, ball.elevation_deg) for ball in balls)
    journal.decision(
        IDENTIFIED,
        {
            "positions": [list(position[1:]) for position in positions],
            "observations": vars(estimation.observations),
            "residuals_mm": estimate.residuals_mm,
            "unresolved_mm2": 0.0 if estimate.misfit is None else estimate.misfit.unresolved_mm2,
            "order": order_text(estimate),
            "volumetric": asdict(estimation.volumetric),
            "thermometer": asdict(estimation.thermometer),
            "travel": estimation.travel.as_record(),
            "table": asdict(TableFacts.of(estimation.table, checksum(format_table(estimation.table)))),
        },
    )


def record_held_out(
    journal: RunJournal,
    job: Job,
    artefact: Artefact,
    before: Sequence[MeasuredBall],
    after: Sequence[MeasuredBall],
) -> None:
    """Write to the journal the rms residual of each held-out position, before and after activation of the new table, in
    µm. `artefact` is the one with which the table was proved.

    Residuals are computed at displayed axis positions, to which the corrections of the table are not added. A position
    is left out if too few balls were found after activation to determine its pose. If too few balls were found before
    activation, the rms residual before activation is None.
    """
    rows = []
    before, after = certified_balls(before, artefact), certified_balls(after, artefact)
    for position in job.held_out:
        rms_um = [_rms_um(job, artefact, [ball for ball in balls if _at(ball, position)]) for balls in (before, after)]
        if rms_um[1] is not None:
            pose = [position.station, position.azimuth_deg, position.elevation_deg]
            rows.append({"position": pose, "before_um": rms_um[0], "after_um": rms_um[1]})
    journal.decision(HELD_OUT, {"positions": rows})


def _at(ball: MeasuredBall, position: Position) -> bool:
    return (ball.station, ball.azimuth_deg, ball.elevation_deg) == (
        position.station,
        position.azimuth_deg,
        position.elevation_deg,
    )


def _rms_um(job: Job, artefact: Artefact, balls: Sequence[MeasuredBall]) -> float | None:
    if len(balls) < MIN_BALLS:
        return None
    return UM_PER_MM * displayed_residuals(balls, job.tool_offset_mm, artefact).rms_mm


def record_outcome(journal: RunJournal, outcome: Outcome) -> None:
    """Write the outcome of the run to the journal. The entry is the JSON object that the command-line option `--json`
    prints, without the path of the report and the verdict, which follows from the rest."""
    omitted = ("report", "verdict")
    journal.decision(OUTCOME, {name: value for name, value in outcome.as_json().items() if name not in omitted})


def input_files(machine: Path, artefact: Path) -> Iterator[Path]:
    """Yield the machine file, the artefact file, and each file that is named in one of these two."""
    for path in (machine, artefact):
        yield path
        with translated(ConfigurationError):
            document = parse_toml(read_text(path, error=ConfigurationError), str(path))
        sections = [document, *(section for section in document.values() if isinstance(section, dict))]
        yield from (
            path.parent / section[key]
            for section in sections
            for key in _NAMED_FILES
            if isinstance(section.get(key), str)
        )


def sha256_of(path: Path) -> str:
    return hashlib.sha256(read_text(path, error=ConfigurationError).encode()).hexdigest()
