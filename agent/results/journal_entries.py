"""What a run writes into the journal beside its steps, so that it can be reported and compared from the journal alone.

The files that the settings name may change or go; what a report says of machine, artefact and result is kept here as it
was.
"""

from __future__ import annotations

import hashlib
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from agent.execution.journal import RunJournal
from agent.files import read_text
from agent.planning.job import Job
from agent.probing.position import MeasuredBall
from agent.probing.preparation import PreparationResult
from agent.results.decision_kinds import HELD_OUT, IDENTIFIED, OUTCOME, PROBE
from agent.results.estimation import EstimationResult, order_text
from agent.results.facts import ArtefactFacts, TableFacts
from agent.results.observations import no_correction, observations_of
from agent.results.probe_facts import probe_facts
from agent.results.run_outcome import Outcome
from drivers.errors import ConfigurationError
from twin.artefact.held_out_check import held_out_residuals
from twin.artefact.position_set import Position
from twin.compensation.table_file import checksum, format_table
from twin.design.procedure import MIN_BALLS

_NAMED_FILES = ("grid", "covariance_file")
"""Keys by which a machine or an artefact file names another one."""


def inputs_of(job: Job) -> dict[str, Any]:
    """What machine, artefact and files a run is begun with. ConfigurationError where a file has gone meanwhile."""
    return {
        "machine": job.machine.name,
        "tools_mm": {name: offset.tolist() for name, offset in job.machine.tools.items()},
        "artefact": asdict(ArtefactFacts.of(job.artefact)),
        "held_out": [[p.station, p.azimuth_deg, p.elevation_deg] for p in job.held_out],
        "files": [
            {"name": path.name, "sha256": sha256_of(path)}
            for path in input_files(job.settings.machine, job.settings.artefact)
        ],
    }


def record_probe(journal: RunJournal, prepared: PreparationResult) -> None:
    """What was found of probe and stylus, as the report shows it."""
    facts = probe_facts(prepared)
    if facts is not None:
        warnings = () if prepared.reversal is None else prepared.reversal.warnings
        journal.decision(PROBE, {"facts": asdict(facts), "warnings": warnings})


def record_identified(journal: RunJournal, balls: Sequence[MeasuredBall], estimation: EstimationResult) -> None:
    """The finding as far as the estimate file does not hold it. `balls`: those observed, in the observations' order."""
    estimate = estimation.estimate
    places = dict.fromkeys((ball.position, ball.station, ball.azimuth_deg, ball.elevation_deg) for ball in balls)
    journal.decision(
        IDENTIFIED,
        {
            "positions": [list(place[1:]) for place in places],
            "observations": vars(estimation.observations),
            "residuals_mm": estimate.residuals_mm,
            "unresolved_mm2": 0.0 if estimate.misfit is None else estimate.misfit.unresolved_mm2,
            "order": order_text(estimate),
            "volumetric": asdict(estimation.volumetric),
            "table": asdict(TableFacts.of(estimation.table, checksum(format_table(estimation.table)))),
        },
    )


def record_held_out(
    journal: RunJournal, job: Job, before: Sequence[MeasuredBall], after: Sequence[MeasuredBall]
) -> None:
    """The rms of each held-out position before and after, as the controller displays it, for those with a pose."""
    rows = []
    for position in job.held_out:
        rms_um = [_left_um(job, [ball for ball in balls if _at(ball, position)]) for balls in (before, after)]
        if rms_um[1] is not None:
            place = [position.station, position.azimuth_deg, position.elevation_deg]
            rows.append({"position": place, "before_um": rms_um[0], "after_um": rms_um[1]})
    journal.decision(HELD_OUT, {"positions": rows})


def _at(ball: MeasuredBall, position: Position) -> bool:
    return (ball.station, ball.azimuth_deg, ball.elevation_deg) == (
        position.station,
        position.azimuth_deg,
        position.elevation_deg,
    )


def _left_um(job: Job, balls: Sequence[MeasuredBall]) -> float | None:
    if len(balls) < MIN_BALLS:
        return None
    displayed = observations_of(balls, job.tool_offset_mm, no_correction)
    return 1e3 * held_out_residuals(displayed, displayed.axis_positions + job.tool_offset_mm, job.artefact).rms_mm


def record_outcome(journal: RunJournal, outcome: Outcome) -> None:
    """What the run came to, as `--json` tells it but for the path of the report."""
    journal.decision(OUTCOME, {name: value for name, value in outcome.as_json().items() if name != "report"})


def input_files(machine: Path, artefact: Path) -> Iterator[Path]:
    """Yield the machine file, the artefact file, and the files that they name."""
    for path in (machine, artefact):
        yield path
        document = tomllib.loads(read_text(path, error=ConfigurationError))
        sections = [document, *(section for section in document.values() if isinstance(section, dict))]
        yield from (
            path.parent / section[key]
            for section in sections
            for key in _NAMED_FILES
            if isinstance(section.get(key), str)
        )


def sha256_of(path: Path) -> str:
    return hashlib.sha256(read_text(path, error=ConfigurationError).encode()).hexdigest()
