"""List of everything that can be stated about a new machine: the options of `volcal init`, and the fields of the set-up
page."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any

from agent.planning.setup_proposal.choices import CALIBRATIONS, MACHINE_CLASS_NAMES, SHAPES, SPINDLES
from agent.planning.setup_proposal.controller_setup import CONTROLLERS
from drivers.errors import InputError

if TYPE_CHECKING:
    from agent.runs.new_machine.answers import InitOptions

LONGEST_TEXT = 400
MACHINE, CONTROLLER, AXES, CHAIN, PROBE, ARTEFACT, MOUNT = STEPS = (
    "machine",
    "controller",
    "axes",
    "chain",
    "probe",
    "artefact",
    "mount",
)
"""Steps of the set-up page in which something is stated."""


class FieldKind(Enum):
    """Form of a value. A triple is three numbers, of X, Y and Z; a travel is a length or LOWEST:HIGHEST."""

    TEXT = "text"
    CHOICE = "choice"
    NUMBER = "number"
    INTEGER = "integer"
    TRIPLE = "triple"
    TRAVELS = "travels"
    FILE = "file"


@dataclass(frozen=True)
class SetupField:
    """Value that a person can state about a machine.

    `flag` is the option of `volcal init`, and `name` the field of `InitOptions`. `step` is the step of the set-up page
    on which the field is. A number is from `lowest` to `highest`. `metavar` stands for the value in the help text.
    """

    flag: str
    text: str
    step: str
    kind: FieldKind = FieldKind.TEXT
    choices: tuple[str, ...] | tuple[int, ...] = ()
    lowest: float = -math.inf
    highest: float = math.inf
    metavar: str | None = None

    @property
    def name(self) -> str:
        name = self.flag.removeprefix("--").replace("-", "_")
        return RENAMED.get(name, name)

    def read(self, text: str) -> Any:
        """Return the value written as `text`, as an option of `volcal init` would have it.

        Raises InputError, which names the option, if `text` is no such value.
        """
        try:
            if len(text) > LONGEST_TEXT or not text.isprintable():
                raise ValueError
            return self._value(text.strip())
        except (ValueError, KeyError):
            raise InputError(f"{text[:LONGEST_TEXT]!r} is not {self._expected}", option=self.flag) from None

    def _value(self, text: str) -> object:
        parts = text.split()
        readers: dict[FieldKind, Callable[[], object]] = {
            FieldKind.TEXT: lambda: text,
            FieldKind.CHOICE: lambda: {str(choice): choice for choice in self.choices}[text],
            FieldKind.NUMBER: lambda: self._bounded(float(text)),
            FieldKind.INTEGER: lambda: int(self._bounded(int(text))),
            FieldKind.TRIPLE: lambda: _three([self._bounded(float(part)) for part in parts]),
            FieldKind.TRAVELS: lambda: _three(parts),
            FieldKind.FILE: lambda: Path(text),
        }
        return readers[self.kind]()

    def _bounded(self, value: float) -> float:
        if not (math.isfinite(value) and self.lowest <= value <= self.highest):
            raise ValueError
        return value

    @property
    def _expected(self) -> str:
        ends = ""
        if math.isfinite(self.highest):
            ends = f" from {self.lowest:g} to {self.highest:g}"
        elif math.isfinite(self.lowest):
            ends = f" of at least {self.lowest:g}"
        return {
            FieldKind.CHOICE: f"one of {', '.join(map(str, self.choices))}",
            FieldKind.NUMBER: f"a number{ends}",
            FieldKind.INTEGER: f"a whole number{ends}",
            FieldKind.TRIPLE: f"three numbers{ends}, for X, Y and Z, separated by blanks",
            FieldKind.TRAVELS: "three travels, of X, Y and Z, separated by blanks",
        }.get(self.kind, f"one line of at most {LONGEST_TEXT} characters")


def _three(parts: Sequence[object]) -> tuple[object, object, object]:
    x, y, z = parts
    return x, y, z


RENAMED = {"class": "machine_class"}

SETUP_FIELDS = (
    SetupField("--name", "Name of the machine [default: that of the directory].", MACHINE),
    SetupField(
        "--class",
        "Class of the machine: typical errors, feeds and chain.",
        MACHINE,
        FieldKind.CHOICE,
        MACHINE_CLASS_NAMES,
    ),
    SetupField("--controller", "Controller [default: simulated].", CONTROLLER, FieldKind.CHOICE, CONTROLLERS),
    SetupField("--address", "HOST[:PORT] of Modbus TCP, or the serial port.", CONTROLLER),
    SetupField("--travel", "Travel in mm: lengths, or LOWEST:HIGHEST positions.", AXES, FieldKind.TRAVELS),
    SetupField("--spindle", "Direction from the spindle to the stylus.", CHAIN, FieldKind.CHOICE, SPINDLES),
    SetupField("--chain", "Kinematic chain, such as tool-Z-bed-Y-X-workpiece.", CHAIN),
    SetupField("--stylus", "Ram reference to stylus centre in mm.", PROBE, FieldKind.NUMBER),
    SetupField("--tip-diameter", "Diameter of the stylus ball in mm.", PROBE, FieldKind.NUMBER),
    SetupField("--stem", "Stylus centre to the body of the probe in mm.", PROBE, FieldKind.NUMBER),
    SetupField("--probe-diameter", "Diameter of the body of the probe in mm.", PROBE, FieldKind.NUMBER),
    SetupField("--rapid", "Rapids in mm/min.", AXES, FieldKind.TRIPLE),
    SetupField("--feed", "Feeds in mm/min.", AXES, FieldKind.TRIPLE),
    SetupField("--acceleration", "Accelerations in mm/s².", AXES, FieldKind.TRIPLE),
    SetupField("--artefact", "Artefact file, of any shape; it is copied.", ARTEFACT, FieldKind.FILE),
    SetupField("--shape", "Shape of a nominal artefact.", ARTEFACT, FieldKind.CHOICE, SHAPES),
    SetupField("--size", "Length of a bar, side of a plate, or edge, in mm.", ARTEFACT, FieldKind.NUMBER),
    SetupField("--balls", "Number of its balls.", ARTEFACT, FieldKind.INTEGER, lowest=2, highest=99),
    SetupField(
        "--tilt", "Tilt of its holders in degrees; 0: straight.", ARTEFACT, FieldKind.NUMBER, lowest=0, highest=60
    ),
    SetupField("--holder", "Length of its holders in mm.", ARTEFACT, FieldKind.NUMBER),
    SetupField("--ball-diameter", "Diameter of its balls in mm.", ARTEFACT, FieldKind.NUMBER),
    SetupField("--calibration", "What is certified of it.", ARTEFACT, FieldKind.CHOICE, CALIBRATIONS),
    SetupField("--certified-length", "Certified distance of its end balls in mm.", ARTEFACT, FieldKind.NUMBER),
    SetupField("--length-uncertainty", "Its standard uncertainty in µm.", ARTEFACT, FieldKind.NUMBER),
    SetupField("--mount-at", "Place of the mount, workpiece frame, in mm.", MOUNT, FieldKind.TRIPLE),
    SetupField("--shaft", "Azimuth axis to the artefact in mm.", MOUNT, FieldKind.NUMBER, lowest=0),
    SetupField("--table-z", "Height of the table, workpiece frame, in mm.", MOUNT, FieldKind.NUMBER),
    SetupField("--stations", "Number of stations.", MOUNT, FieldKind.INTEGER, lowest=1, highest=20),
    SetupField("--position-set", "S1, S2, S3, joined by +, or a position file.", MOUNT, metavar="SET"),
    SetupField("--touches", "Touches of each ball: 5, 9, 13 or 25.", MOUNT, FieldKind.CHOICE, (5, 9, 13, 25)),
)
"""All fields in the order of the help text."""


def read_options(texts: Mapping[str, str]) -> InitOptions:
    """Return the options for the texts of fields by name. Raises InputError for the first text that is no value."""
    from agent.runs.new_machine.answers import InitOptions  # noqa: PLC0415  slow to import, `volcal init --help` has only the fields

    return InitOptions(**{field.name: field.read(texts[field.name]) for field in SETUP_FIELDS if field.name in texts})


def option_texts(options: Mapping[str, Any]) -> dict[str, str]:
    """Return the texts of the options that were given, as `read_options` reads them."""
    return {name: " ".join(str(part) for part in _parts(value)) for name, value in options.items() if value is not None}


def _parts(value: object) -> tuple[object, ...]:
    return value if isinstance(value, tuple) else (value,)
