"""All files of a new machine, written and checked together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from agent.model_files import load_artefact
from agent.planning.job import Job
from agent.planning.job_preparation import prepare_job, prepare_layout, reached_balls
from agent.planning.new_machine.artefact_text import artefact_text
from agent.planning.new_machine.fields import MOUNT_AT, TABLE_Z
from agent.planning.new_machine.hand_placement import hand_positions, room_above_mm
from agent.planning.new_machine.machine_setup import STATED
from agent.planning.new_machine.machine_text import machine_text
from agent.planning.new_machine.new_setup import (
    ARTEFACT_FILE,
    LAST_EFFORT,
    MACHINE_FILE,
    POSITIONS_FILE,
    SETTINGS_FILE,
    NewSetup,
)
from agent.planning.new_machine.settings_text import scenario_text, settings_text
from agent.planning.new_machine.station_setup import positions_of, station_axis
from agent.settings.load import load_settings
from agent.settings.simulator_command import SCENARIO_FILE
from drivers.errors import ConfigurationError, InputError
from twin.artefact.position_set import MIN_BALLS, Position
from twin.formats.position_set_file import format_positions
from twin.machine.kinematic_chain import AXES


def checked_files(setup: NewSetup, directory: Path) -> tuple[Mapping[str, str], Job]:
    """Write the files of a new machine into the empty scratch `directory`, check them as `volcal config check` does,
    and return their texts by file name, and the job that they describe.

    Without a named set, a position file with the orientations that the probe can measure is among the files. Raises
    ConfigurationError if the files contradict each other, for example because no ball is within reach.
    """
    named = setup.named_set
    if setup.stations.by_hand and named is None:
        return _placed_by_hand(setup, directory)
    texts = _texts(setup, named or LAST_EFFORT.named_set)
    job = _written(texts, directory)
    if named is not None:
        _refuse_stated_place(setup, job, job.positions)
        return texts, job
    proposed = positions_of(setup.stations, setup.machine.spindle, is_bar=setup.artefact.is_bar)
    _refuse_stated_place(setup, job, proposed)
    measurable = [position for position in proposed if reached_balls(job, position) >= MIN_BALLS]
    if not measurable:
        raise ConfigurationError(
            "no proposed position has three balls within the travel",
            key="stations.places_mm",
            hint="check the stations' places, the mount's shaft and the tool offset",
        )
    texts = {**_texts(setup, POSITIONS_FILE), POSITIONS_FILE: format_positions(measurable)}
    return texts, _written(texts, directory)


def _placed_by_hand(setup: NewSetup, directory: Path) -> tuple[Mapping[str, str], Job]:
    """Return the texts and the job of an artefact that is placed by hand, with the positions within reach."""
    texts = _texts(setup, POSITIONS_FILE)
    _write(texts, directory)
    artefact = load_artefact(directory / ARTEFACT_FILE)
    room_mm = room_above_mm(setup.machine, setup.stations, artefact)
    if room_mm < 0.0:
        if setup.stations.origins["places_mm"] == STATED:
            where, other = f"at the place ({_first_place_text(setup)})", f"place ({MOUNT_AT.flag})"
        else:
            where = f"on a table at Z = {setup.stations.table_z_mm:g} mm"
            other = f"height of the table ({TABLE_Z.flag})"
        raise ConfigurationError(
            f"the artefact is {-room_mm:.0f} mm too high to be touched from above {where}",
            key="stations.places_mm",
            hint=f"state a smaller artefact or another {other}",
        )
    layout = prepare_layout(load_settings(directory / SETTINGS_FILE))
    positions = tuple(
        position
        for position in hand_positions(setup.stations)
        if int(layout.reachable(position, layout.nominal(position)).sum()) >= MIN_BALLS
    )
    if not positions:
        raise ConfigurationError(
            "no proposed position has three balls within the travel",
            key="stations.places_mm",
            hint="state a smaller artefact, other places or a longer travel",
        )
    texts[POSITIONS_FILE] = format_positions(positions)
    job = _written(texts, directory)
    _refuse_stated_place(setup, job, positions)
    return texts, job


def _refuse_stated_place(setup: NewSetup, job: Job, positions: Sequence[Position]) -> None:
    """Raise InputError if none of `positions` can be measured at the stated place of the mount."""
    here = [position for position in positions if position.station == 1]
    if not here or setup.stations.origins["places_mm"] != STATED:
        return
    if all(reached_balls(job, position) < MIN_BALLS for position in here):
        axis = AXES.index(station_axis(setup.machine))
        low, high = setup.machine.stylus_range(axis)
        raise InputError(
            f"no position has three balls within the travel if the mount stands at ({_first_place_text(setup)})",
            hint=f"the stylus centre reaches {AXES[axis]} from {low:g} to {high:g} mm in the workpiece frame",
            option=MOUNT_AT.flag,
        )


def _first_place_text(setup: NewSetup) -> str:
    return ", ".join(f"{value:g}" for value in setup.stations.places_mm[0])


def _texts(setup: NewSetup, position_set: str) -> dict[str, str]:
    """Return the texts of machine, artefact, settings and scenario file by file name."""
    return {
        MACHINE_FILE: machine_text(setup.machine),
        **(setup.artefact_files or {ARTEFACT_FILE: artefact_text(setup.artefact, setup.machine.spindle)}),
        SETTINGS_FILE: settings_text(setup, position_set),
        SCENARIO_FILE: scenario_text(setup.machine, setup.stations),
    }


def _write(texts: Mapping[str, str], directory: Path) -> None:
    for name, text in texts.items():
        (directory / name).write_text(text, encoding="utf-8")


def _written(texts: Mapping[str, str], directory: Path) -> Job:
    _write(texts, directory)
    return prepare_job(load_settings(directory / SETTINGS_FILE), directory)
