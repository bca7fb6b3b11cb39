"""Choice of the measurements of a new machine: as few as are expected to pass all gates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from agent.planning.job import Job
from agent.planning.setup_files.new_setup import LAST_EFFORT, NewSetup, checked_files
from agent.results.gate_forecast import GateForecast, forecast_gates
from agent.results.gates import PROOF

GAIN = "gain"
GOOD_GAIN = 0.6
"""Relative decrease of the volumetric error at which more measurements are not worth their time."""

HELD_OUT = (8, 16)
"""Numbers of held-out positions, in ascending order, if the default cannot show the predicted improvement."""


@dataclass(frozen=True)
class ChosenFiles:
    """Files of a new machine by name, the job that they describe, and the forecast of the gates of its first run."""

    texts: Mapping[str, str]
    job: Job
    forecasts: Sequence[GateForecast]

    @property
    def passes(self) -> bool:
        """True if every gate is expected to pass."""
        return all(forecast.passes for forecast in self.forecasts)

    @property
    def lacks_proof(self) -> bool:
        """True if all that is missing is a proof of the new table."""
        return [forecast.gate for forecast in self.forecasts if not forecast.passes] == [PROOF]

    @property
    def gain(self) -> float:
        """Expected relative decrease of the volumetric error by the first table."""
        return next(one.expected for one in self.forecasts if one.gate == GAIN and one.expected is not None)


def choose_effort(setup: NewSetup, scratch: Path) -> ChosenFiles:
    """Return the files with the smallest effort that is expected to pass all gates with a good gain.

    If none is, the largest effort is taken; the last one, which takes hours, only if the others are not expected to
    pass all gates. A position set that a person named is kept; then only the number of touches is chosen. The files are
    checked in the empty directory `scratch`. Raises ConfigurationError if they contradict each other.
    """
    first, *more = setup.efforts
    chosen = _provable(replace(setup, effort=first), scratch)
    for effort in more:
        if chosen.passes and (chosen.gain >= GOOD_GAIN or effort == LAST_EFFORT):
            break
        chosen = _provable(replace(setup, effort=effort), scratch)
    return chosen


def _provable(setup: NewSetup, scratch: Path) -> ChosenFiles:
    """Return the files of `setup` with as many held-out positions as are needed to prove the first table."""
    chosen = _files(setup, scratch)
    for count in HELD_OUT:
        if not chosen.lacks_proof:
            break
        chosen = _files(replace(setup, held_out_positions=count), scratch)
    return chosen


def _files(setup: NewSetup, scratch: Path) -> ChosenFiles:
    texts, job = checked_files(setup, scratch)
    return ChosenFiles(texts, job, forecast_gates(job))
