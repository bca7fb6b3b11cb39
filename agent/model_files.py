"""Reading of machine, artefact, position and ball files. The functions return objects of the package `twin`, which
contains the numerical model of the machine.

This module is separate from `agent.files`, which reads and writes any text file, so that a command that needs none of
the model files does not import the numerical code of `twin`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from agent.files import read_text, translated
from drivers.errors import ConfigurationError, InputError, VolcalError
from twin.artefact.artefact import Artefact
from twin.artefact.position_set import Position
from twin.formats.artefact_file import parse_artefact
from twin.formats.ball_file import BallFile, parse_balls
from twin.formats.instrument_file import InstrumentMachine, parse_instrument
from twin.formats.machine_file import parse_machine
from twin.formats.position_set_file import parse_positions
from twin.identification.instruments.readings import InstrumentReadings
from twin.machine.error_model import ErrorModel
from twin.machine.machine_description import MachineDescription

MAX_LISTED = 100
"""Largest number of files that are looked into for a list."""


def load_machine(path: Path) -> MachineDescription:
    """Return the machine described by a machine file.

    If the machine file names a file with a deflection grid (displacements of the tool point by gravity), this file is
    read too. Its path is relative to the machine file.
    """
    text = read_text(path, error=ConfigurationError)
    with translated(ConfigurationError, file=str(path)):
        return parse_machine(text, str(path), _neighbours(path))


def load_artefact(path: Path) -> Artefact:
    """Return the artefact described by an artefact file.

    If the artefact file names a file with the covariance of the ball centres, this file is read too. Its path is
    relative to the artefact file.
    """
    text = read_text(path, error=ConfigurationError)
    with translated(ConfigurationError, file=str(path)):
        return parse_artefact(text, str(path), _neighbours(path))


def load_positions(path: Path) -> tuple[Position, ...]:
    text = read_text(path)
    with translated(InputError, file=str(path)):
        return parse_positions(text, str(path))


def position_set_names(folder: Path) -> tuple[str, ...]:
    """Return the names of the files in `folder` that are position sets, sorted. Other files are left out, without a
    word on why they cannot be read."""
    found = []
    for path in sorted(folder.glob("*.csv"))[:MAX_LISTED]:
        try:
            load_positions(path)
        except VolcalError:
            continue
        found.append(path.name)
    return tuple(found)


def load_balls(path: Path, machine: MachineDescription) -> BallFile:
    """Return the measured ball centres from a CSV file.

    Raises InputError if the file cannot be used, names a tool that `machine` does not have, or contains axis positions
    outside the travel of `machine`.
    """
    text = read_text(path)
    with translated(InputError, file=str(path)):
        return parse_balls(text, str(path), machine.tools, travel=machine.limits)


def load_instruments(
    paths: Sequence[Path], machine: MachineDescription, model: ErrorModel
) -> tuple[InstrumentReadings, ...]:
    """Return the readings of other instruments, one file for each. They are named like their files; `model` is the
    error model whose parameters an earlier report may state.

    Raises InputError if a file cannot be used, or if two files have the same name.
    """
    known = InstrumentMachine(machine.tools, machine.limits, model)
    found = []
    for number, path in enumerate(paths):
        if path.name in (other.name for other in paths[:number]):
            hint = "results name an instrument by its file: rename one of the two"
            raise InputError("a second file of an instrument has the same name", hint=hint, file=str(path))
        text = read_text(path)
        with translated(InputError, file=str(path)):
            found.append(parse_instrument(text, str(path), path.name, known))
    return tuple(found)


def _neighbours(path: Path) -> Callable[[str], str]:
    """Return a reader of files that are named relative to `path`."""
    return lambda name: read_text(path.parent / name, error=ConfigurationError)
