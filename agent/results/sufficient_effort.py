"""Choice of the measurements of a new machine: as few as are expected to pass all gates."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from agent.planning.job import Job
from agent.planning.setup_files.new_setup import LAST_EFFORT, NewSetup, checked_files
from agent.results.gate_forecast import GateForecast, forecast_gates

GAIN = "gain"
MARGIN = 0.85
"""Expected remaining share relative to its limit: a run may do somewhat worse than expected."""
HIGHEST_LIMIT = 0.8
STEPS = 20
"""A raised limit is a multiple of one over this number."""


@dataclass(frozen=True)
class ChosenFiles:
    """Files of a new machine by name, the job that they describe, and the forecast of the gates of its first run."""

    texts: Mapping[str, str]
    job: Job
    forecasts: Sequence[GateForecast]

    @property
    def is_sufficient(self) -> bool:
        """True if every gate is expected to pass, the gate `gain` with a margin."""
        return all(forecast.passes for forecast in self.forecasts) and self.gain <= MARGIN * self.limit

    @property
    def gain(self) -> float:
        """Expected share of the volumetric error that remains with the table active."""
        return next(one.expected for one in self.forecasts if one.gate == GAIN and one.expected is not None)

    @property
    def limit(self) -> float:
        return self.job.gate_limits.max_remaining_fraction


def choose_effort(setup: NewSetup, scratch: Path) -> ChosenFiles:
    """Return the files with the smallest effort that is expected to pass all gates.

    If none is, the last effort is taken, and the limit of the gate `gain` is raised to what can be expected, but not
    beyond `HIGHEST_LIMIT`. A position set that a person named is kept; then only the number of touches is chosen. The
    files are checked in the empty directory `scratch`. Raises ConfigurationError if they contradict each other.
    """
    first, *more = setup.efforts
    setup = replace(setup, effort=first)
    chosen = _files(setup, scratch)
    for effort in more:
        if chosen.is_sufficient or (effort == LAST_EFFORT and _raised(chosen) <= HIGHEST_LIMIT):
            break
        setup = replace(setup, effort=effort)
        chosen = _files(setup, scratch)
    if chosen.limit < _raised(chosen) <= HIGHEST_LIMIT:
        return _files(replace(setup, max_remaining_fraction=_raised(chosen)), scratch)
    return chosen


def _raised(chosen: ChosenFiles) -> float:
    """Return the limit of the gate `gain` that leaves the margin to what is expected."""
    return math.ceil(STEPS * chosen.gain / MARGIN) / STEPS


def _files(setup: NewSetup, scratch: Path) -> ChosenFiles:
    texts, job = checked_files(setup, scratch)
    return ChosenFiles(texts, job, forecast_gates(job))
