"""Reading and writing of files: machines, artefacts, ball centres, positions, estimates and compensation tables."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Mapping
from importlib.resources import files
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory

from twin.artefact.artefact import Artefact
from twin.artefact.position_set import Position
from twin.compensation.table import CompensationTable
from twin.compensation.table_file import format_side_file, format_table, parse_table
from twin.errors import FormatError
from twin.formats.artefact_file import parse_artefact
from twin.formats.ball_file import BallFile, format_balls, parse_balls
from twin.formats.compressed_text import MAGIC, SUFFIX, expand_text
from twin.formats.estimate_file import StoredEstimate, format_estimate, parse_estimate
from twin.formats.machine_file import parse_machine
from twin.formats.position_set_file import format_positions, parse_positions
from twin.identification import Estimate
from twin.machine.machine_description import MachineDescription

PathName = str | PathLike[str]


def shipped_file(name: str) -> Path:
    """Return the path of a file from the configuration that is shipped with volcal, such as `machines/case-study.toml`.

    Raises FormatError if there is no such file. The error message lists the files in the same folder.

    >>> volcal.shipped_file("machines/case-study.toml").name
    'case-study.toml'
    """
    root = Path(str(files("volcal") / "config"))
    path = root / name
    if not path.is_file():
        folder = path.parent if path.parent.is_dir() else root
        found = ", ".join(sorted(entry.name for entry in folder.iterdir()))
        raise FormatError("there is no such shipped file", hint=f"Shipped in that folder: {found}", file=name)
    return path


def read_machine(path: PathName) -> MachineDescription:
    """Return the machine that is described by a machine file (TOML).

    The file describes the kinematic chain, the travel of the axes, the tools, the error model, the prior population and
    the deflection of the machine structure. If the file names a deflection grid, that grid is read as well; its path is
    relative to the machine file. Raises FormatError, which names file and key, if the file is invalid.

    >>> machine = volcal.read_machine(volcal.shipped_file("machines/case-study.toml"))
    >>> machine.name, machine.model.size
    ('case-study', 90)
    >>> machine.tool("probe")
    array([  0., 250.,   0.])
    """
    return parse_machine(text_of(path), str(path), _beside(path))


def read_artefact(path: PathName) -> Artefact:
    """Return the ball artefact that is described by an artefact file (TOML).

    The file contains the calibrated ball centres with their covariance, the ball diameter and the thermal expansion.
    Raises FormatError, which names file and key, if the file is invalid, and DataError if a value is physically
    impossible.

    >>> artefact = volcal.read_artefact(volcal.shipped_file("artefacts/ball-bar-1500.toml"))
    >>> artefact.count
    11
    """
    return parse_artefact(text_of(path), str(path), _beside(path))


def read_balls(path: PathName, machine: MachineDescription) -> BallFile:
    """Return the measured ball centres of a ball file (CSV).

    Every tool named in the file must be a tool of `machine`, and every axis position must lie in its travel. Raises
    FormatError, which names file, row and column, if the file is invalid.

    >>> balls = volcal.read_balls(volcal.shipped_file("examples/case-study-balls.csv"), setup.machine)
    >>> balls.observations.size, len(balls.positions)
    (260, 24)
    """
    return parse_balls(text_of(path), str(path), machine.tools, travel=machine.limits)


def read_positions(path: PathName) -> tuple[Position, ...]:
    """Return the artefact positions of a position file in the order of measuring.

    The file is TOML if it has the suffix `.toml`, and otherwise CSV. Raises FormatError, which names the file and the
    row, column or key, if the file is invalid.

    >>> volcal.read_positions(volcal.shipped_file("linuxcnc/few-positions.csv"))[0]
    Position(station=1, azimuth_deg=0.0, elevation_deg=45.0, tool=None, balls=None)
    """
    return parse_positions(text_of(path), str(path))


def read_estimate(path: PathName) -> StoredEstimate:
    """Return an estimate that is stored in a JSON file.

    The file was written by the command `volcal identify`, by a calibration run, or by `write_estimate`. Raises
    FormatError, which names file and key, if the file is invalid.
    """
    return parse_estimate(text_of(path), str(path))


def read_table(path: PathName) -> CompensationTable:
    """Return the compensation table that is stored in a CSV file and in a JSON side file with the same name.

    Raises FormatError, which names the file and the row, column or key, if a file is invalid. FormatError is also
    raised if the checksum in the side file does not match the table.
    """
    side = Path(path).with_suffix(".json")
    return parse_table(text_of(path), text_of(side), str(path), str(side))


def write_balls(balls: BallFile, machine: MachineDescription, path: PathName) -> Path:
    """Write measured ball centres to a ball file (CSV) and return its path.

    The covariance of each ball centre is reduced to one standard uncertainty.
    """
    tools = list(machine.tools)
    return _write(path, format_balls(balls.observations, balls.positions, tools, balls.temperature_was_read))


def write_positions(positions: tuple[Position, ...], path: PathName) -> Path:
    """Write artefact positions to a position file (CSV) and return its path."""
    return _write(path, format_positions(positions))


def write_estimate(estimate: Estimate, path: PathName, provenance: Mapping[str, str] | None = None) -> Path:
    """Write an estimate to a JSON file and return its path.

    `provenance` contains named texts that are stored with the estimate, such as the software version and dates.
    """
    return _write(path, format_estimate(estimate, provenance or {}))


def write_table(table: CompensationTable, path: PathName) -> Path:
    """Write a compensation table to a CSV file and a JSON side file with the same name. Return the path of the CSV
    file.
    """
    target = Path(path)
    write_texts(
        target.parent, {target.with_suffix(".json").name: format_side_file(table), target.name: format_table(table)}
    )
    return target


def text_of(path: PathName) -> str:
    """Return the text of a UTF-8 file. If there is only a compressed file, whose name has the further ending `.gz`, its
    text is returned. Raises FormatError with the path if the file cannot be read."""
    try:
        return _content(Path(path)).decode("utf-8-sig")
    except FileNotFoundError:
        raise FormatError("there is no such file", hint="Check the path", file=str(path)) from None
    except UnicodeDecodeError:
        raise FormatError("the file is not UTF-8 text", hint="Save it as UTF-8", file=str(path)) from None
    except OSError as error:
        raise FormatError(f"the file cannot be read: {error.strerror or error}", file=str(path)) from None


def _content(path: Path) -> bytes:
    compressed = path.with_name(path.name + SUFFIX) if path.name else path
    content = (compressed if not path.exists() and compressed.is_file() else path).read_bytes()
    if not content.startswith(MAGIC):
        return content
    try:
        return expand_text(content)
    except FormatError as error:
        raise error.at(file=str(path)) from None


def _beside(path: PathName) -> Callable[[str], str]:
    """Return a function that reads files whose names are relative to `path`."""
    return lambda name: text_of(Path(path).parent / name)


def _write(path: PathName, text: str) -> Path:
    target = Path(path)
    write_texts(target.parent, {target.name: text})
    return target


def write_texts(folder: Path, texts: Mapping[str, str]) -> None:
    """Write the texts of files by their names into a folder, which is created if it is missing.

    All texts are written in full under temporary names before the first file is replaced, so that none of them is left
    half written, or beside former ones, if the folder cannot hold them. Raises OSError in this case.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for name in texts:
        if (folder / name).is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(folder / name))
    with TemporaryDirectory(dir=folder, prefix=".volcal-") as staged:
        for name, text in texts.items():
            (Path(staged) / name).write_text(text, encoding="utf-8")
        for name in texts:
            (Path(staged) / name).replace(folder / name)
