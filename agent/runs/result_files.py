"""Result files of a run, or of an identification from files: ball centres, estimate, table and report. Each file is
complete or absent."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from agent.execution.run_record import read_record
from agent.files import write_all_atomically
from agent.planning.job import Job
from agent.reports.run_report import measured_positions
from agent.results.artefact_calibration import calibration_texts
from agent.results.estimation import EstimationResult, estimate_text, provenance
from agent.results.gates.gate import Gate
from agent.results.gates.required_gates import names_of_failed
from agent.results.run_outcome import Outcome
from agent.runs.run_results import RunResults
from drivers.errors import InputError
from twin.artefact.position_set import Position
from twin.compensation.table_file import format_side_file, format_table
from twin.formats.ball_file import format_balls

REPORT = "report.html"
IDENTIFY = "identify-"
"""Begin of the identity of an identification from files."""
ESTIMATE_FILE = "estimate.json"
_ORIGIN_BYTES = 4096  # the origin stands at the begin of an estimate file
_BY_IDENTIFY = re.compile(rb'"run_id":\s*"' + IDENTIFY.encode())


def write_results(job: Job, outcome: Outcome, progress: RunResults, report: Mapping[str, str | bytes]) -> Outcome:
    """Write the available result files of a run to the directory ``STATE_DIRECTORY/RUN_ID``. Return a copy of the run's
    `outcome` that also contains the path of the run's report.

    If the run has no estimate, only the report is written; the measurements of the run are in the journal. `report`
    maps the name of each file of the report to its content.
    """
    state = job.settings.state_directory
    texts = dict(report)
    if progress.estimation is not None:
        positions = measured_positions(read_record(state, outcome.run_id))
        texts |= _results(job, outcome.run_id, progress.estimation, positions, progress.gates)
    if not texts:
        return outcome
    directory = state / outcome.run_id
    write_all_atomically(directory, texts)
    return replace(outcome, report=directory / REPORT) if REPORT in report else outcome


def _results(
    job: Job, run_id: str, estimation: EstimationResult, positions: Sequence[Position], gates: Sequence[Gate]
) -> dict[str, str]:
    """Return the texts of the result files by file name. The table carries a mark if one of `gates` was not passed."""
    table = replace(estimation.table, gates_not_passed=names_of_failed(gates))
    origin = provenance(job, run_id)
    calibration = estimation.estimate.artefact_calibration
    return {
        "balls.csv": format_balls(estimation.observations, positions, [job.settings.tool]),
        "estimate.json": estimate_text(estimation, origin),
        "table.csv": format_table(table),
        "table.json": format_side_file(table),
        **calibration_texts(calibration, job.artefact, run_id, origin["time"], job.machine.name),
    }


def replaced_results(folder: Path, names: Iterable[str], inputs: Iterable[Path]) -> tuple[str, ...]:
    """Return those of the files `names` in `folder` that an earlier identification from files has written.

    If the estimate beside them is that of a run on a machine, or if there is none, they are the user's: none is
    returned. Nor are the files that the new identification reads, `inputs`, and those whose names begin like that of
    such a file: an artefact file reads a file with its covariance.
    """
    origin = b""
    with suppress(OSError), (folder / ESTIMATE_FILE).open("rb") as file:
        origin = file.read(_ORIGIN_BYTES)
    if _BY_IDENTIFY.search(origin) is None:
        return ()
    read = {path.stem for path in inputs if path.resolve().parent == folder.resolve()}
    return tuple(name for name in names if not any(name.startswith(stem) for stem in read))


def check_inputs_kept(folder: Path, names: Iterable[str], inputs: Iterable[Path]) -> None:
    """Raise InputError if one of the files `names` in `folder`, which are to be written or deleted, is among the files
    that an identification has read, `inputs`."""
    read = {path.resolve() for path in inputs}
    for path in (folder / name for name in names):
        if path.resolve() in read:
            raise InputError(
                "a result would replace this file, which the identification reads",
                hint="choose another directory for the results",
                file=str(path),
            )
