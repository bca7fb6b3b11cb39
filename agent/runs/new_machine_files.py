"""Files of a new machine: chosen, checked, planned and written together."""

from __future__ import annotations

import shlex
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from agent.errors import PlanRefused
from agent.files import write_all_atomically
from agent.planning.design.set_valuation import valuation_of
from agent.planning.job import Job
from agent.planning.job_preparation import reached_balls
from agent.planning.new_machine.answers import SetupAnswers
from agent.planning.new_machine.artefact_setup import BY_HAND, SIZES_MM, STRAIGHT_BAR
from agent.planning.new_machine.fields import PLACEMENT, SHAPE, SIZE, TRAVEL
from agent.planning.new_machine.machine_setup import Triple
from agent.planning.new_machine.new_setup import LAST_EFFORT, POSITIONS_FILE, SETTINGS_FILE, NewSetup
from agent.planning.new_machine.setup_files import checked_files
from agent.results.gates.gate_forecast import GateForecast, forecast_gates
from agent.results.gates.gate_rules import PROOF
from agent.runs.kinds.calibrate import calibration_of, preflight_of
from drivers.errors import ConfigurationError, InputError, VolcalError
from twin.artefact.position_set import MIN_BALLS
from twin.units import S_PER_MIN

PREVIEW = "preview"
"""Directory of the preview, in the directory of the machine."""
GAIN = "gain"
GOOD_GAIN = 0.6
"""Relative decrease of the volumetric error at which more measurements are not worth their time."""

KEYS_OF_REACH = ("stations.places_mm", "verification.positions", "verification.positions_deg", "procedure.position_set")
"""Keys that an error names if too few balls or positions of a proposed set are within reach."""

LONG_MM = 400.0
"""Travel of every axis at which the smallest proposed artefact fits."""
TRAVEL_STEP_MM = 10.0
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


@dataclass(frozen=True)
class NewFiles:
    """Checked files of a new machine, and the plan of its first run.

    `plan` contains the figures of the plan. `refused` is the error of its preflight, None if the plan can be run. The
    files that the job names are in the scratch directory in which they were checked.
    """

    setup: NewSetup
    chosen: ChosenFiles
    plan: Mapping[str, Any]
    refused: PlanRefused | None

    @property
    def texts(self) -> Mapping[str, str]:
        """Texts of the files by name."""
        return self.chosen.texts

    @property
    def forecasts(self) -> Sequence[GateForecast]:
        return self.chosen.forecasts

    @property
    def ready(self) -> bool:
        """True if neither the preflight nor a gate is expected to refuse a run with these files."""
        return self.refused is None and self.chosen.passes

    def write(self, directory: Path) -> list[Path]:
        """Write all files into `directory`, or none, and return their paths."""
        removed = () if POSITIONS_FILE in self.texts else (POSITIONS_FILE,)
        write_all_atomically(directory, self.texts, removed=removed)
        return [directory / name for name in self.texts]

    def draw(self, folder: Path) -> list[Path]:
        """Write the preview of the plan into `folder`, and return the paths of its files."""
        from agent.planning.preview.preview_files import write_preview  # noqa: PLC0415  plotting is slow to import

        return write_preview(self.chosen.job, calibration_of, folder, self.refused)

    def document(self, directory: Path) -> dict[str, Any]:
        """Return the result of the set-up in `directory` as `volcal init --json` prints it, without the preview."""
        return {
            "directory": str(directory),
            "files": [str(directory / name) for name in self.texts],
            **self.plan,
            "gates": [forecast.as_json() for forecast in self.forecasts],
            "next": next_commands(self.setup, directory, ready=self.ready),
        }


def prepare_files(answers: SetupAnswers, scratch: Path) -> NewFiles:
    """Return the checked files of the machine that the answers describe.

    The size of a proposed artefact is reduced until it fits and the preflight accepts the plan. Raises InputError if an
    answer is missing or impossible, or if a stated artefact does not fit; the error then names the largest one that
    does, or if no artefact fits. Raises ConfigurationError if the files contradict each other. `scratch` is an empty
    directory.
    """
    first = setup = answers.collect()
    hand_places = setup.stations.by_hand and setup.position_set is None
    refused: NewSetup | None = None
    while True:
        failed: ConfigurationError | PlanRefused | None
        try:
            files = _prepared(setup, scratch)
            failed = files.refused
            refused = refused or setup
        except ConfigurationError as error:
            if setup.position_set is not None or error.where.get("key") not in KEYS_OF_REACH:
                raise
            failed = error
        if failed is None:
            return files
        smaller = answers.with_smaller_artefact(setup)
        if smaller is None:
            break
        setup = smaller
    # All sizes were tried with the places as stated; with proposed places, a larger one may fit.
    setup = first if hand_places else setup
    fitting = _largest_fitting(answers, setup, scratch)
    if fitting is not None:
        raise _does_not_fit(setup, fitting, failed) from failed
    if refused is not None and not hand_places:
        return _prepared(refused, scratch)
    least = _least_travel(answers, setup, scratch) if hand_places else None
    raise InputError(
        f"no artefact that is proposed fits a travel of {_travel_text(setup.machine.travel_mm)}, not even a straight "
        f"bar of {SIZES_MM[STRAIGHT_BAR][0]} mm with three balls: {failed.message}",
        hint=f"correct the travel or what is stated of the {'places' if hand_places else 'mount'}"
        + ("" if least is None else f"; one of {_travel_text(least)} would do{_without_stated_places(answers)}"),
        option=TRAVEL.flag,
    ) from failed


def _without_stated_places(answers: SetupAnswers) -> str:
    """Return the part of the hint that names the stated options to be omitted, empty if there are none."""
    flags = answers.stated_place_flags()
    return f", and without what is stated of the places ({', '.join(flags)})" if flags else ""


def _travel_text(travel_mm: Triple) -> str:
    return f"{' × '.join(f'{length:g}' for length in travel_mm)} mm"


def _least_travel(answers: SetupAnswers, setup: NewSetup, scratch: Path) -> Triple | None:
    """Return travels of X, Y and Z in mm, not shorter than those of the machine and none longer than needed, at which
    the smallest bar that is placed by hand can be measured; None if there are none."""
    *_, smallest = answers.fitting_candidates(setup)
    own = setup.machine.travel_mm

    def fits(travel_mm: Triple) -> bool:
        try:
            _, job = checked_files(answers.on_travel(smallest, travel_mm), scratch)
            # The forecast takes much longer than this count, so it comes last.
            if all(reached_balls(job, position) < MIN_BALLS for position in job.held_out):
                return False
            forecast_gates(job)
        except (ConfigurationError, InputError):
            return False
        return True

    least = (max(own[0], LONG_MM), max(own[1], LONG_MM), max(own[2], LONG_MM))
    if not fits(least):
        return None
    for axis in range(3):
        lengths = [own[axis], *np.arange(TRAVEL_STEP_MM, least[axis], TRAVEL_STEP_MM).tolist(), least[axis]]
        offered = [(*least[:axis], length, *least[axis + 1 :]) for length in lengths if length >= own[axis]]
        least = offered[bisect_left(offered, True, key=fits)]
    return least if _prepared(answers.on_travel(smallest, least), scratch).refused is None else None


def _largest_fitting(answers: SetupAnswers, setup: NewSetup, scratch: Path) -> NewSetup | None:
    """Return the set-up with the largest proposed artefact whose plan the preflight accepts, None if there is none."""
    for candidate in answers.fitting_candidates(setup):
        try:
            if _prepared(candidate, scratch).refused is None:
                return candidate
        except (ConfigurationError, InputError):
            continue
    return None


def _does_not_fit(setup: NewSetup, fitting: NewSetup, failed: VolcalError) -> InputError:
    """Return the error for an artefact that does not fit, with the options of the largest one that does."""
    artefact, stations = fitting.artefact, fitting.stations
    options = [SHAPE.flag, artefact.shape, SIZE.flag, f"{artefact.size_mm:g}"]
    if stations.by_hand:
        options += [PLACEMENT.flag, BY_HAND]
    pitch = f", {artefact.size_mm / (artefact.balls - 1):g} mm apart" if artefact.is_bar else ""
    omitted = "the other options of the artefact"
    if stations.origins != setup.stations.origins or len(stations.places_mm) != len(setup.stations.places_mm):
        omitted += " and of the mount"
    return InputError(
        f"an artefact of {setup.artefact.size_mm:g} mm with {setup.artefact.balls} balls does not fit this machine: "
        f"{failed.message}",
        hint=f"the largest that fits is a {artefact.shape} with {artefact.balls} balls of {artefact.diameter_mm:g} mm"
        f"{pitch}, at {len(stations.places_mm)} stations: state {shlex.join(options)} and omit {omitted}",
        option=SIZE.flag,
    )


def refuse_existing(directory: Path) -> None:
    """Raise InputError if the directory contains the settings of a machine."""
    settings = directory / SETTINGS_FILE
    if settings.exists():
        raise InputError(
            "the directory already contains the settings of a machine",
            hint="choose another directory, or add --force",
            file=str(settings),
        )


def next_commands(setup: NewSetup, directory: Path, *, ready: bool) -> list[str]:
    """Return the commands to be typed next, in order.

    None of them writes a table to a real controller: the last one for it is `volcal try`, and a person decides after
    that. If a run is expected to be refused (`ready` is False), there is nothing to calibrate yet.
    """
    enter = [] if directory.resolve() == Path.cwd() else [shlex.join(("cd", str(directory)))]
    if not ready:
        return [*enter, "volcal plan"]
    commands = [*enter, "volcal calibrate --simulated"]
    return commands if setup.controller.is_simulated else [*commands, "volcal doctor", "volcal try"]


def _prepared(setup: NewSetup, scratch: Path) -> NewFiles:
    """Return the files of one set-up. An error of their check names the file as it will be called."""
    try:
        chosen = choose_effort(setup, scratch)
    except ConfigurationError as error:
        error.where = {key: value.removeprefix(f"{scratch.resolve()}/") for key, value in error.where.items()}
        raise error.at(file=SETTINGS_FILE) from error.__cause__
    refused, plan = _plan(chosen.job)
    return NewFiles(setup, chosen, plan, refused)


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


def _plan(job: Job) -> tuple[PlanRefused | None, dict[str, object]]:
    """Run the preflight. Return the error if it refuses the plan, and the figures of the plan."""
    try:
        preflight = preflight_of(job)
    except PlanRefused as refused:
        return refused, {"positions": len(job.positions)}
    return None, {
        "positions": len(job.positions),
        "left_out": list(preflight.measured.left_out),
        "balls": sum(len(position.balls) for position in preflight.measured.positions),
        "machine_minutes": round(preflight.machine_seconds / S_PER_MIN, 1),
        "valuation_percent": round(valuation_of(job, job.positions).percent, 1),
    }
