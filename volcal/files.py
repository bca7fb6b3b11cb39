"""Reading and writing of files: machine, artefact, ball centres, positions, estimate and compensation table."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib.resources import files
from os import PathLike
from pathlib import Path

from twin.artefact.artefact import Artefact
from twin.artefact.position_set import Position
from twin.compensation.table import CompensationTable
from twin.compensation.table_file import format_side_file, format_table, parse_table
from twin.errors import FormatError
from twin.formats.artefact_file import parse_artefact
from twin.formats.ball_file import BallFile, format_balls, parse_balls
from twin.formats.estimate_file import StoredEstimate, format_estimate, parse_estimate
from twin.formats.machine_file import parse_machine
from twin.formats.position_set_file import format_positions, parse_positions
from twin.identification import Estimate
from twin.machine.machine_description import MachineDescription

PathName = str | PathLike[str]


def shipped_file(name: str) -> Path:
    """Return the path of a file from the configuration that is shipped with volcal, such as `machines/case-study.toml`.

    Raises FormatError, listing the files in the same folder, if there is no such file.

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
    """Return the machine described by a machine file (TOML): chain, travel, tools, error model, prior population,
    deflection.

    The deflection grid that the file names is read as well; its path is relative to the machine file. Raises
    FormatError with file and key.

    >>> machine = volcal.read_machine(volcal.shipped_file("machines/case-study.toml"))
    >>> machine.name, machine.model.size
    ('case-study', 90)
    >>> machine.tool("probe")
    array([  0., 250.,   0.])
    """
    return parse_machine(_text(path), str(path), _beside(path))


def read_artefact(path: PathName) -> Artefact:
    """Return the ball artefact described by an artefact file (TOML): calibrated centres with covariance, diameter,
    expansion.

    Raises FormatError with file and key, and DataError for impossible values.

    >>> artefact = volcal.read_artefact(volcal.shipped_file("artefacts/ball-bar-1500.toml"))
    >>> artefact.count
    11
    """
    return parse_artefact(_text(path), str(path), _beside(path))


def read_balls(path: PathName, machine: MachineDescription) -> BallFile:
    """Return the measured ball centres of a ball file (CSV).

    The tool names in the file must be tools of `machine`. Raises FormatError with file, row and column.

    >>> balls = volcal.read_balls(volcal.shipped_file("examples/case-study-balls.csv"), setup.machine)
    >>> balls.observations.size, len(balls.positions)
    (260, 24)
    """
    return parse_balls(_text(path), str(path), machine.tools)


def read_positions(path: PathName) -> tuple[Position, ...]:
    """Return the positions of a position file (CSV, or TOML by its suffix), in the order of measuring.

    Raises FormatError with file and row, column or key.

    >>> volcal.read_positions(volcal.shipped_file("linuxcnc/few-positions.csv"))[0]
    Position(station=1, azimuth_deg=0.0, elevation_deg=45.0, tool=None)
    """
    return parse_positions(_text(path), str(path))


def read_estimate(path: PathName) -> StoredEstimate:
    """Return a stored estimate (JSON), which was written by the command `volcal identify`, by a run or by
    `write_estimate`.

    Raises FormatError with file and key.
    """
    return parse_estimate(_text(path), str(path))


def read_table(path: PathName) -> CompensationTable:
    """Return a compensation table from its CSV file and the JSON side file of the same name.

    Raises FormatError with file and row, column or key. It is also raised if the checksum in the side file does not
    match the table.
    """
    side = Path(path).with_suffix(".json")
    return parse_table(_text(path), _text(side), str(path), str(side))


def write_balls(balls: BallFile, machine: MachineDescription, path: PathName) -> Path:
    """Write ball centres as a ball file and return its path. The covariance of each ball is reduced to one standard
    uncertainty."""
    return _write(path, format_balls(balls.observations, balls.positions, list(machine.tools)))


def write_positions(positions: tuple[Position, ...], path: PathName) -> Path:
    """Write a position file (CSV) and return its path."""
    return _write(path, format_positions(positions))


def write_estimate(estimate: Estimate, path: PathName, provenance: Mapping[str, str] | None = None) -> Path:
    """Write an estimate (JSON) and return its path. `provenance`: names and texts to store with the estimate, such as
    software version and dates."""
    return _write(path, format_estimate(estimate, provenance or {}))


def write_table(table: CompensationTable, path: PathName) -> Path:
    """Write a compensation table (CSV) and, next to it, a JSON side file of the same name. Return the path of the
    table."""
    _write(Path(path).with_suffix(".json"), format_side_file(table))
    return _write(path, format_table(table))


def _text(path: PathName) -> str:
    """Return the text of a UTF-8 file. Raises FormatError with the path if the file cannot be read."""
    try:
        return Path(path).read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise FormatError("there is no such file", hint="Check the path", file=str(path)) from None
    except UnicodeDecodeError:
        raise FormatError("the file is not UTF-8 text", hint="Save it as UTF-8", file=str(path)) from None
    except OSError as error:
        raise FormatError(f"the file cannot be read: {error.strerror or error}", file=str(path)) from None


def _beside(path: PathName) -> Callable[[str], str]:
    """Return a function that reads files whose names are relative to `path`."""
    return lambda name: _text(Path(path).parent / name)


def _write(path: PathName, text: str) -> Path:
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(text, encoding="utf-8")
    return target
