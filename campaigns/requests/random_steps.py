"""Random choice of what happens in one trial, by weights that depend on the state of the owner."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path
from time import perf_counter, process_time

import numpy as np
import structlog
from numpy.random import Generator
from numpy.typing import NDArray

from agent.execution.states import RunState
from agent.service.allowed_requests import RESTORE_FORMER, RESUME_RUN, START
from benchmarks.places import memory_directory
from campaigns.requests.trial import ACTIONS, REQUESTS, Count, RequestTrial

RARE = {
    "end_service": 0.2,
    "kill": 0.1,
    "cut_or_connect": 0.4,
    "refuse_or_permit": 0.2,
    "read_idle": 0.3,
    "reload": 0.3,
}
"""Weights of events that are not requests, while no run is in progress."""
WAITING = {"go_on": 0.1, "go_to_the_next_state": 0.1}
AT_REST = {**RARE, **WAITING, "start": 2.0}
"""Weights of the actions while no run is in progress, where they are not 1."""
RUNNING = {
    **{"abort": 0.06, "end_service": 0.03, "kill": 0.02, "cut_or_connect": 0.3, "refuse_or_permit": 0.1},
    **{"go_on": 2.0, "go_to_the_next_state": 0.2, "resume": 1.5, "answer": 2.0, "start": 0.2, "restore_table": 0.1},
}
"""Weights while a run is in progress. With more aborts, runs would hardly come beyond their first touches."""
PROVING = {**RUNNING, "abort": 0.2, "kill": 0.3, "refuse_or_permit": 0.6}
"""Weights while a new table is active that is not proved yet: the run often ends there, and cannot restore."""
UNPROVED = {**RARE, **WAITING, "refuse_or_permit": 0.6, "restore_former": 2.0, "give_up": 1.0, "resume_run": 2.0}
"""Weights while no run is in progress and an unproved table is active."""
UNFINISHED = {**RARE, **WAITING, "resume_run": 3.0}
"""Weights while no run is in progress and an unfinished run is offered."""
CLOSED = {**WAITING, "end_service": 5.0}
"""Weights while the service is closed and no run is in progress: it starts again soon."""
NOT_OFFERED = 0.25
"""Factor of the weight of a request that the status does not offer, and that is therefore refused."""
OFFERED_AS = {"restore_table": START}
"""Requests that the status offers under another name. A reload is not offered by it."""
NAMES = list(ACTIONS)


def play_trial(seed: int, number: int, steps: int, ends_s: float) -> tuple[Count, float]:
    """Carry out one trial of so many steps, or until `ends_s` of `perf_counter`, which is the same in all processes.
    Return what happened, and the CPU time in s that it took."""
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
    began_s, count = process_time(), Count()
    if perf_counter() < ends_s:
        play(np.random.default_rng([seed, number]), steps, count, ends_s)
    return count, process_time() - began_s


def play(rng: Generator, steps: int, count: Count, ends_s: float) -> None:
    """Carry out one trial of so many steps, or until `ends_s` of `perf_counter`, and add what happened to `count`."""
    with memory_directory("requests") as directory:
        trial = RequestTrial(Path(directory), count)
        try:
            for _ in range(steps):
                if perf_counter() > ends_s:
                    break
                trial.perform(str(rng.choice(NAMES, p=_shares(trial))), lambda n: int(rng.integers(n)))
        finally:
            trial.close()


def _shares(trial: RequestTrial) -> NDArray[np.float64]:
    """Return the probability of each of `NAMES`, an array of their number."""
    weights, may = _weights(trial), trial.may

    def weight(name: str) -> float:
        is_offered = name not in REQUESTS or name == "reload" or OFFERED_AS.get(name, name) in may
        return weights.get(name, 1.0) * (1.0 if is_offered else NOT_OFFERED)

    drawn = [weight(name) for name in NAMES]
    return np.array([one / sum(drawn) for one in drawn])


def _weights(trial: RequestTrial) -> Mapping[str, float]:
    if not trial.at_rest:
        return PROVING if trial.state in (RunState.ACTIVATING, RunState.VERIFYING) else RUNNING
    if trial.closed:
        return CLOSED
    if RESTORE_FORMER in trial.may:
        return UNPROVED
    return UNFINISHED if RESUME_RUN in trial.may else AT_REST
