"""What an OPC UA client is told about past calibrations: of a journal written here, run by run."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

import pytest

from agent.execution.journal import Journal, RunJournal
from agent.execution.journal_reader import open_journal
from agent.execution.states import RunState
from agent.execution.steps import CheckProbe, ReadPosition
from agent.results.decision_kinds import OUTCOME, PROBE, PROOF
from agent.results.run_verdict import Look
from agent.service.opcua.last_calibration import JournalResults, journal_results
from drivers.clock import VirtualClock

RINGS = {"facts": {"rings": [{"n": 1}]}}
CHECKED = CheckProbe("probe/station-1/az0-el0/probe")
PARKED = ReadPosition("probe/mounts/here")


class Runs:
    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.journal = Journal(directory)

    def begun(self, run_id: str, step: CheckProbe | ReadPosition | None, settings: dict | None = None) -> RunJournal:
        run = self.journal.start_run(run_id, "calibrate", settings or {}, "1.0", VirtualClock())
        run.state(RunState.PREFLIGHT)
        run.origin({})
        run.begun()
        if step is not None:
            run.begin(step)
        return run

    def ended(self, run_id: str, *, good: bool, serial_number: str | None = None) -> datetime:
        probe = {"opcua": {"probe": {"serial_number": serial_number}}}
        run = self.begun(run_id, None, probe if serial_number else None)
        run.decision(PROOF, {"accepted": good})
        run.state(RunState.COMPLETE if good else RunState.REFUSED, final=True)
        run.decision(OUTCOME, {"estimated_ve_um": 38.5, "predicted_vce_um": 4.0})
        with open_journal(self.directory) as reader:
            return datetime.fromisoformat(str(reader.require_run(run_id).ended))

    def read(self) -> JournalResults:
        return journal_results(self.directory)


@pytest.fixture
def runs(tmp_path: Path) -> Runs:
    return Runs(tmp_path)


def test_nothing_is_known_without_a_journal(tmp_path: Path) -> None:
    assert journal_results(tmp_path) == JournalResults(None, None, None)


def test_a_calibration_that_has_failed_is_the_last_one_but_moves_no_date(runs: Runs) -> None:
    ended = runs.ended("a", good=True, serial_number="A-16")
    runs.ended("b", good=False)
    found = runs.read()
    assert found.last is not None
    assert (found.last.run_id, found.last.verdict.name) == ("b", "refused")
    assert found.last_good is not None
    assert (found.last_good.run_id, found.last_good.ended) == ("a", ended)
    assert found.last_good.verdict.look is Look.GOOD


def test_the_probe_is_that_of_the_settings_of_the_run(runs: Runs) -> None:
    runs.ended("a", good=True, serial_number="A-16")
    first = runs.read().last
    runs.ended("b", good=True)
    second = runs.read().last
    assert (first and first.probe_serial_number, second and second.probe_serial_number) == ("A-16", None)


def test_a_check_that_has_not_passed_leaves_nothing_qualified(runs: Runs) -> None:
    runs.begun("a", CHECKED).decision(PROBE, RINGS)
    assert runs.read().stylus_qualified is True
    runs.begun("b", PARKED)  # a run without checks of the probe
    assert runs.read().stylus_qualified is True
    runs.begun("c", CHECKED)  # the check raises, and the run writes no decision
    assert runs.read().stylus_qualified is None
    runs.begun("d", CHECKED).decision(PROBE, {"facts": {"rings": []}})
    assert runs.read().stylus_qualified is None


def test_an_older_run_that_is_resumed_and_fails_its_check_counts_as_the_latest(runs: Runs) -> None:
    older = runs.begun("a", CHECKED)
    runs.begun("b", CHECKED).decision(PROBE, RINGS)
    assert runs.read().stylus_qualified is True
    older.state(RunState.RESUMING)
    assert runs.read().stylus_qualified is None
    older.decision(PROBE, RINGS)
    assert runs.read().stylus_qualified is True
