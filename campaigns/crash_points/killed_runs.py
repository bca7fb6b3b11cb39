"""Execution of the run that is killed, with its journal in a file."""

from __future__ import annotations

import gc
import logging
from contextlib import chdir
from dataclasses import replace
from pathlib import Path

import structlog

from agent.execution.states import RunState
from agent.planning.case_file import SHIPPED_CONFIGURATION
from agent.planning.job_preparation import prepare_job
from agent.runs.kinds.calibrate import FullCalibration
from agent.runs.session import carry_out
from benchmarks.places import memory_directory
from campaigns.aborts.case import prepare_case
from campaigns.crash_points.crash_recorder import STATE, CrashRecorder, PointSelection, journal_reader, watched_commits
from campaigns.faults.fault_injector import FaultInjector
from campaigns.faults.fault_scene import FaultScene, build_world
from campaigns.faults.night_record import NightRecord
from campaigns.faults.nights import cpu_s, run_hooks
from campaigns.resume.case import cache_preflight

ACCEPTED, ABORTED = "accepted", "aborted"
RUNS = (ACCEPTED, ABORTED)
EXPECTED = {ACCEPTED: (True, RunState.COMPLETE), ABORTED: (False, RunState.ABORTED)}
"""Whether the table of each run is accepted, and the state in which the run ends."""
PROOF = "verify/"
"""Beginning of the keys of the steps that measure with the new table."""


def play_run(selection: PointSelection, run: str) -> tuple[dict[str, int], list[tuple[str, NightRecord]], float]:
    """Carry out the run, and kill it at the selected points. Return the number of points by kind, the records with the
    kinds of their points, and the CPU time in s that this took."""
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
    began_s = cpu_s()
    cache_preflight()
    with memory_directory("crash-points") as name, chdir(name):
        scene = FaultScene(build_world(0), journal_reader)
        injector = FaultInjector(scene, (), 0.0, lambda *_: None)
        recorder = CrashRecorder(injector, selection, "" if run == ACCEPTED else PROOF)
        job = prepare_case(Path(name), stations={"standing_at": 1})
        job = prepare_job(job.settings.model_copy(update={"state_directory": STATE}), SHIPPED_CONFIGURATION)
        hooks = replace(run_hooks(injector, recorder.rig), answers=recorder.answers)
        gc.collect()
        gc.freeze()
        with watched_commits(recorder.notify):
            ended = carry_out(job, FullCalibration(), SHIPPED_CONFIGURATION, hooks)
        gc.unfreeze()
        recorder.over = True
        proof = ended.outcome.proof
        if (proof is not None and proof.accepted, ended.outcome.state) != EXPECTED[run]:
            raise RuntimeError(f"the run that is not killed ended otherwise: {ended.outcome.reason}")
    return recorder.counted, recorder.records, cpu_s() - began_s
