"""Table of everything that can be stated about a new machine."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from agent.planning.new_machine.artefact_geometry import nominal_length_mm
from agent.planning.new_machine.artefact_setup import (
    BALL_PLATE,
    BY_HAND,
    CERTIFICATE,
    LENGTH,
    NONE,
    ON_MOUNT,
    STRAIGHT_BAR,
    TETRAHEDRON,
    TILTED_BAR,
    ArtefactSetup,
    check_balls,
    check_tilt,
    nominal_artefact,
    propose_shape,
    propose_size,
)
from agent.planning.new_machine.controller_setup import LINUXCNC, MODBUS, SERIAL, SIMULATED
from agent.planning.new_machine.field import Answers, FieldKind, SetupField
from agent.planning.new_machine.machine_class import MACHINE_CLASSES
from agent.planning.new_machine.machine_setup import Limits, ThreeLimits, Triple, check_travel, lengths_of
from agent.planning.new_machine.spindle import SPINDLES, parse_spindle, spindle_name
from drivers.errors import InputError
from drivers.roles import AxisLimits
from twin.errors import DataError
from twin.machine.kinematic_chain import AXES, parse_chain
from twin.units import S_PER_MIN

MACHINE, CONTROLLER, TRAVEL_STEP, CHAIN_STEP, PROBE, ARTEFACT_STEP, MOUNT = STEPS = (
    "machine",
    "controller",
    "axes",
    "chain",
    "probe",
    "artefact",
    "mount",
)
"""Steps of the set-up page in which something is stated."""

TEXT, CHOICE, NUMBER, INTEGER = FieldKind.TEXT, FieldKind.CHOICE, FieldKind.NUMBER, FieldKind.INTEGER
TRIPLE, TRAVELS, FILE = FieldKind.TRIPLE, FieldKind.TRAVELS, FieldKind.FILE
CLASS_WORDS_DE = {
    "mill": "Bearbeitungszentrum oder Fräsmaschine mit bewegtem Tisch",
    "router": "leichte Portalmaschine mit festem Tisch, etwa mit GRBL oder LinuxCNC",
    "portal": "Portal- oder Brückenmaschine mit festem Tisch",
    "large-ram": "Fahrständermaschine mit waagrechtem Stößel",
}
CLASSES = "; ".join(f"{kind.name}: {kind.description}" for kind in MACHINE_CLASSES.values())
NOT_READ = "typical of the class, not read from the controller"


def parse_travels(text: str) -> ThreeLimits:
    """Return the lowest and highest axis position of X, Y and Z, each written as a length or as LOWEST:HIGHEST.

    Raises DataError if there are not three travels or if one is not a range of numbers.
    """
    texts = text.split()
    if len(texts) != len(AXES):
        raise DataError(f"{len(texts)} travels, three are needed", hint="state X, Y and Z, such as 800 500 400")
    x, y, z = limits = tuple(_limits_of(text) for text in texts)
    for axis, (low, high) in zip(AXES, limits, strict=True):
        check_travel(axis, low, high)
    return x, y, z


def stated_artefact(answers: Answers) -> ArtefactSetup:
    """Return the nominal artefact that the answers describe, without its calibration."""
    proposed = _nominal(answers)
    diameter, balls = answers[BALL_DIAMETER], answers[BALLS]
    return replace(
        proposed,
        balls=balls,
        tilt_deg=answers[TILT],
        holder_mm=answers[HOLDER],
        diameter_mm=diameter,
        origins=answers.origins,
    )


def option_texts(options: Mapping[str, Any]) -> dict[str, str]:
    """Return the texts of the options of `volcal init` that were given, by name of the field.

    Raises InputError, which names the option, if a text is empty.
    """
    texts = {name: _joined(value) for name, value in options.items() if value is not None}
    for name, text in texts.items():
        if not text.strip():
            flag = FIELDS[name].flag
            raise InputError(f"{flag} is empty", hint=f"state a value, or omit {flag}", option=flag)
    return texts


def catalogue() -> dict[str, dict[str, str]]:
    """Return the labels of the fields and the words of their choices, in English and German, by key of the page."""
    words = {f"field.{field.name}": (field.en, field.de) for field in SETUP_FIELDS}
    for field in SETUP_FIELDS:
        words |= {f"{field.name}.{choice}": pair for choice, pair in field.words.items() if pair is not None}
    return {key: {"en": en, "de": de} for key, (en, de) in words.items()}


def _joined(value: object) -> str:
    """Return the text of a number, a text, or three of them. A whole number has no decimal point."""
    parts = value if isinstance(value, tuple) else (value,)
    return " ".join(str(part).removesuffix(".0") if isinstance(part, float) else str(part) for part in parts)


def _limits_of(text: str) -> Limits:
    low, separator, high = text.partition(":")
    try:
        limits = (float(low), float(high)) if separator else (0.0, float(low))
    except ValueError:
        limits = (0.0, 0.0)
    if not limits[0] < limits[1]:
        raise DataError(f"'{text}' is not a travel", hint="write a length in mm, or LOWEST:HIGHEST, such as -254:0")
    return limits


def _length(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < math.inf:
        raise DataError(f"'{text}' is not a length in mm")
    return value


def _triple(text: str) -> Triple:
    x, y, z = (float(part) for part in text.split())
    return x, y, z


def _dynamics(text: str) -> Triple:
    values = _triple(text)
    if not all(0.0 < value < math.inf for value in values):
        raise DataError(f"'{_shortly(values)}' are not three values above 0, for X, Y and Z")
    return values


def _shortly(values: Iterable[float]) -> str:
    return " ".join(f"{value:g}" for value in values)


def _finite(values: Triple) -> Triple | None:
    return values if all(map(math.isfinite, values)) else None


def _reported_travel(limits: AxisLimits) -> ThreeLimits | None:
    x, y, z = zip(limits.lower_mm, limits.upper_mm, strict=True)
    return (x, y, z) if all(map(math.isfinite, (*x, *y, *z))) else None


def _reported_rapid(limits: AxisLimits) -> Triple | None:
    x, y, z = limits.rapid_mm_per_s
    return _finite((S_PER_MIN * x, S_PER_MIN * y, S_PER_MIN * z))


def _typical(answers: Answers) -> str:
    return f"typical of class {answers[MACHINE_CLASS].name}"


def _nominal(answers: Answers) -> ArtefactSetup:
    return nominal_artefact(answers[SHAPE], answers[SIZE])


MACHINE_CLASS = SetupField(
    flag="--class", step=MACHINE, kind=CHOICE, meaning=MACHINE_CLASSES.__getitem__,
    en="Class of the machine", de="Maschinenart",
    option="Class of the machine: typical errors, feeds and chain.", question=f"Class of the machine ({CLASSES})",
    words={name: (kind.description, CLASS_WORDS_DE[name]) for name, kind in MACHINE_CLASSES.items()},
    shown=lambda setup: setup.machine.kind.name,
)  # fmt: skip
NAME = SetupField(
    flag="--name", step=MACHINE, kind=TEXT, meaning=str, key="name",
    en="Name of the machine", de="Name der Maschine",
    option="Name of the machine [default: that of the directory].", question="Name of the machine",
    proposal=lambda answers: answers.directory.resolve().name or answers[MACHINE_CLASS].name,
    shown=lambda setup: setup.machine.name,
)  # fmt: skip
CONTROLLER_KIND = SetupField(
    flag="--controller", step=CONTROLLER, kind=CHOICE, meaning=str,
    en="Kind of controller", de="Art der Steuerung",
    option="Controller [default: simulated].", question="Controller of the machine",
    words={
        SIMULATED: ("simulated", "simuliert"),
        MODBUS: ("Modbus TCP", "Modbus TCP"),
        SERIAL: ("GRBL on a serial port", "GRBL an serieller Schnittstelle"),
        LINUXCNC: ("LinuxCNC on this computer", "LinuxCNC auf diesem Rechner"),
    },
    proposal=lambda _: SIMULATED, shown=lambda setup: setup.controller.kind,
)  # fmt: skip
ADDRESS = SetupField(
    flag="--address", step=CONTROLLER, kind=TEXT, meaning=str,
    en="Address: host or host:port of Modbus TCP, or the serial port",
    de="Adresse: Rechner oder Rechner:Port für Modbus TCP, oder serielle Schnittstelle",
    option="HOST[:PORT] of Modbus TCP, or the serial port.",
    question=lambda answers: "HOST or HOST:PORT of its Modbus TCP server"
    if answers[CONTROLLER_KIND] == MODBUS else "Name of its serial port",
)  # fmt: skip
TRAVEL = SetupField(
    flag="--travel", step=TRAVEL_STEP, kind=TRAVELS, meaning=parse_travels, reported=_reported_travel,
    en="Axis positions at the ends of the travel in mm", de="Achspositionen an den Enden der Verfahrwege in mm",
    option="Travel in mm: lengths, or LOWEST:HIGHEST positions.",
    question="Travel of X, Y and Z in mm, separated by blanks (a length, or LOWEST:HIGHEST axis position)",
    shown=lambda setup: " ".join(f"{low:g}:{high:g}" for low, high in setup.machine.limits_mm),
    key="range_mm", comment="axis positions at the ends of the travel (soft limits)",
)  # fmt: skip
SPINDLE = SetupField(
    flag="--spindle", step=CHAIN_STEP, kind=CHOICE, meaning=parse_spindle, words=dict.fromkeys(SPINDLES),
    en="Direction from the spindle to the stylus", de="Richtung von der Spindel zur Tastkugel",
    question="Spindle direction, from the spindle to the stylus",
    proposal=lambda answers: answers[MACHINE_CLASS].spindle, origin=_typical,
    shown=lambda setup: spindle_name(setup.machine.spindle),
)  # fmt: skip
CHAIN = SetupField(
    flag="--chain", step=CHAIN_STEP, kind=TEXT, meaning=lambda text: str(parse_chain(text)),
    en="Kinematic chain from the tool to the workpiece", de="Achsfolge vom Werkzeug zum Werkstück",
    option="Kinematic chain, such as tool-Z-bed-Y-X-workpiece.",
    question="Kinematic chain from the tool to the workpiece",
    proposal=lambda answers: answers[MACHINE_CLASS].chain(answers[SPINDLE], lengths_of(answers[TRAVEL])),
    origin=_typical, shown=lambda setup: setup.machine.chain,
    key="chain", comment="from the tool to the workpiece",
)  # fmt: skip
STYLUS = SetupField(
    flag="--stylus", step=PROBE, kind=NUMBER, meaning=_length,
    en="Distance from the ram reference (spindle nose) to the stylus centre in mm",
    de="Abstand vom Bezugspunkt (Spindelnase) zur Mitte der Tastkugel in mm",
    option="Ram reference to stylus centre in mm.",
    question="Distance from the ram reference to the stylus centre in mm",
    proposal=lambda answers: f"{answers[MACHINE_CLASS].stylus_mm:g}", origin=_typical,
    shown=lambda setup: f"{setup.machine.stylus_mm:g}",
)  # fmt: skip
TIP_DIAMETER = SetupField(
    flag="--tip-diameter", step=PROBE, kind=NUMBER, meaning=lambda text: 0.5 * float(text),
    en="Diameter of the stylus ball in mm", de="Durchmesser der Tastkugel in mm",
    shown=lambda setup: f"{2.0 * setup.machine.probe['tip_radius_mm']:g}",
    key="tip_radius_mm", comment="radius of the stylus ball",
)  # fmt: skip
STEM = SetupField(
    flag="--stem", step=PROBE, kind=NUMBER, meaning=float,
    en="Stylus centre to the body of the probe in mm", de="Mitte der Tastkugel bis Tastergehäuse in mm",
    shown=lambda setup: f"{setup.machine.probe['stem_length_mm']:g}",
    key="stem_length_mm", comment="from the stylus centre to the body of the probe",
)  # fmt: skip
PROBE_DIAMETER = SetupField(
    flag="--probe-diameter", step=PROBE, kind=NUMBER, meaning=lambda text: 0.5 * float(text),
    en="Diameter of the body of the probe in mm", de="Durchmesser des Tastergehäuses in mm",
    shown=lambda setup: f"{2.0 * setup.machine.probe['body_radius_mm']:g}",
    key="body_radius_mm", comment="radius of the body of the probe",
)  # fmt: skip
RAPID = SetupField(
    flag="--rapid", step=TRAVEL_STEP, kind=TRIPLE, meaning=_dynamics, reported=_reported_rapid,
    en="Rapids in mm/min", de="Eilgang in mm/min",
    proposal=lambda answers: _joined((answers[MACHINE_CLASS].rapid_mm_per_min,) * 3), origin=NOT_READ,
    shown=lambda setup: _shortly(setup.machine.rapid_mm_per_min),
    key="rapid_mm_per_min", comment="rapid",
)  # fmt: skip
FEED = SetupField(
    flag="--feed", step=TRAVEL_STEP, kind=TRIPLE, meaning=_dynamics,
    en="Feeds in mm/min", de="Vorschübe in mm/min",
    proposal=lambda answers: _joined((answers[MACHINE_CLASS].feed_mm_per_min,) * 3), origin=NOT_READ,
    shown=lambda setup: _shortly(setup.machine.feed_mm_per_min),
    key="feed_mm_per_min", comment="feed",
)  # fmt: skip
ACCELERATION = SetupField(
    flag="--acceleration", step=TRAVEL_STEP, kind=TRIPLE, meaning=_dynamics,
    reported=lambda limits: _finite(limits.acceleration_mm_per_s2),
    en="Accelerations in mm/s²", de="Beschleunigungen in mm/s²",
    proposal=lambda answers: _joined((answers[MACHINE_CLASS].acceleration_mm_per_s2,) * 3), origin=NOT_READ,
    shown=lambda setup: _shortly(setup.machine.acceleration_mm_per_s2),
    key="acceleration_mm_per_s2", comment="for predicted minutes",
)  # fmt: skip
ARTEFACT = SetupField(
    flag="--artefact", step=ARTEFACT_STEP, kind=FILE, meaning=Path,
    en="File of the artefact on this computer (any shape)",
    de="Datei des Prüfkörpers auf diesem Rechner (beliebige Form)",
    option="Artefact file, of any shape; it is copied.",
)  # fmt: skip
SHAPE = SetupField(
    flag="--shape", step=ARTEFACT_STEP, kind=CHOICE, meaning=str,
    en="Shape of the artefact", de="Form des Prüfkörpers", option="Shape of a nominal artefact.",
    question="Shape of the artefact (a file of one: option --artefact)",
    words={
        TILTED_BAR: ("ball bar with tilted holders", "Kugelstab mit geneigten Haltern"),
        STRAIGHT_BAR: ("ball bar with straight holders", "Kugelstab mit geraden Haltern"),
        BALL_PLATE: ("ball plate", "Kugelplatte"),
        TETRAHEDRON: ("tetrahedron", "Tetraeder"),
    },
    proposal=lambda answers: propose_shape(lengths_of(answers[TRAVEL])),
    shown=lambda setup: setup.artefact.shape or None,
)  # fmt: skip
SIZE = SetupField(
    flag="--size", step=ARTEFACT_STEP, kind=NUMBER, meaning=_length,
    en="Length of a bar between its end balls, side of a plate, or edge of a tetrahedron, in mm",
    de="Länge des Stabs zwischen den Endkugeln, Seite der Platte oder Kante des Tetraeders in mm",
    option="Length of a bar, side of a plate, or edge, in mm.",
    question="Length of the bar between its end balls, side of the plate between its corner balls, or edge, in mm",
    proposal=lambda answers: f"{propose_size(answers[SHAPE], lengths_of(answers[TRAVEL])):g}",
    origin="proposed from the travel", shown=lambda setup: f"{setup.artefact.size_mm:g}",
    key="length_mm", comment="between the centres of the end balls",
)  # fmt: skip
BALLS = SetupField(
    flag="--balls", step=ARTEFACT_STEP, kind=INTEGER, meaning=lambda text: int(_length(text)), lowest=2, highest=99,
    check=lambda answers, balls: check_balls(answers[SHAPE], balls),
    en="Number of its balls", de="Anzahl der Kugeln", question="Number of its balls",
    proposal=lambda answers: f"{_nominal(answers).balls}", shown=lambda setup: f"{setup.artefact.balls}",
    key="balls", comment="number of balls",
)  # fmt: skip
TILT = SetupField(
    flag="--tilt", step=ARTEFACT_STEP, kind=NUMBER, meaning=float, lowest=0, highest=60,
    check=lambda answers, tilt_deg: check_tilt(answers[SHAPE], tilt_deg) if tilt_deg else None,
    en="Tilt of its holders in degrees; 0: straight", de="Neigung der Halter in Grad; 0: gerade",
    proposal=lambda answers: f"{_nominal(answers).tilt_deg:g}", shown=lambda setup: f"{setup.artefact.tilt_deg:g}",
    key="tilt_deg", comment="holders tilted alternately up, out, down and in; 0: straight",
)  # fmt: skip
HOLDER = SetupField(
    flag="--holder", step=ARTEFACT_STEP, kind=NUMBER, meaning=_length,
    en="Length of its holders in mm", de="Länge der Halter in mm",
    proposal=lambda answers: f"{_nominal(answers).holder_mm:g}", shown=lambda setup: f"{setup.artefact.holder_mm:g}",
    key="holder_length_mm", comment="from the axis of the bar to a ball centre",
)  # fmt: skip
BALL_DIAMETER = SetupField(
    flag="--ball-diameter", step=ARTEFACT_STEP, kind=NUMBER, meaning=_length,
    en="Diameter of its balls in mm", de="Durchmesser der Kugeln in mm", question="Diameter of its balls in mm",
    proposal=lambda answers: f"{_nominal(answers).diameter_mm:g}",
    shown=lambda setup: f"{setup.artefact.diameter_mm:g}", key="ball_diameter_mm",
)  # fmt: skip
CALIBRATION = SetupField(
    flag="--calibration", step=ARTEFACT_STEP, kind=CHOICE, meaning=str,
    en="What is certified", de="Was kalibriert ist", option="What is certified of it.",
    question="What is certified: all ball centres (certificate), the length between two balls (length), or none",
    words={
        CERTIFICATE: ("all ball centres: a certificate", "alle Kugelmitten: ein Kalibrierschein"),
        LENGTH: ("one length", "eine Länge"),
        NONE: ("nothing", "nichts"),
    },
    proposal=lambda _: CERTIFICATE, shown=lambda setup: setup.artefact.calibration.kind,
)  # fmt: skip
CERTIFIED_LENGTH = SetupField(
    flag="--certified-length", step=ARTEFACT_STEP, kind=NUMBER, meaning=_length,
    en="Certified distance of the end balls in mm (plate: opposite corners)",
    de="Kalibrierter Abstand der Endkugeln in mm (Platte: gegenüberliegende Ecken)",
    option="Certified distance of its end balls in mm.",
    question="Certified distance in mm of the end balls (plate: opposite corners; tetrahedron: corners 0 and 1)",
    proposal=lambda answers: f"{nominal_length_mm(stated_artefact(answers)):.4f}",
    shown=lambda setup: _of_length(setup.artefact, f"{setup.artefact.calibration.length_mm or 0.0:.4f}"),
)  # fmt: skip
LENGTH_UNCERTAINTY = SetupField(
    flag="--length-uncertainty", step=ARTEFACT_STEP, kind=NUMBER, meaning=_length,
    en="Its standard uncertainty in µm (k = 1)", de="Dessen Standardunsicherheit in µm (k = 1)",
    option="Its standard uncertainty in µm.", question="Its standard uncertainty in µm (k = 1)",
    proposal=lambda _: "1",
    shown=lambda setup: _of_length(setup.artefact, f"{setup.artefact.calibration.length_uncertainty_um:g}"),
)  # fmt: skip
PLACEMENT = SetupField(
    flag="--placement", step=MOUNT, kind=CHOICE, meaning=str,
    en="How the artefact is held", de="Wie der Prüfkörper gehalten wird",
    option="How the artefact is held [default: mount].",
    words={
        ON_MOUNT: ("by a rotary mount", "von einer Drehaufnahme"),
        BY_HAND: ("by hand on the table", "von Hand aufgestellt"),
    },
    proposal=lambda _: ON_MOUNT, shown=lambda setup: BY_HAND if setup.stations.by_hand else ON_MOUNT,
)  # fmt: skip
MOUNT_AT = SetupField(
    flag="--mount-at", step=MOUNT, kind=TRIPLE, meaning=_triple,
    en="Place of the mount at station 1 in the workpiece frame in mm",
    de="Ort der Aufnahme an Station 1 im Werkstücksystem in mm",
    option="Place of the mount at station 1, workpiece frame, in mm.",
    shown=lambda setup: _shortly(setup.stations.places_mm[0]),
)  # fmt: skip
SHAFT = SetupField(
    flag="--shaft", step=MOUNT, kind=NUMBER, meaning=float, lowest=0,
    en="Azimuth axis to the artefact in mm", de="Drehachse (Azimut) bis Prüfkörper in mm",
    shown=lambda setup: f"{setup.stations.shaft_mm:g}",
)  # fmt: skip
TABLE_Z = SetupField(
    flag="--table-z", step=MOUNT, kind=NUMBER, meaning=float,
    en="Height of the table in the workpiece frame in mm", de="Höhe des Tisches im Werkstücksystem in mm",
    option="Height of the table, workpiece frame, in mm.", shown=lambda setup: f"{setup.stations.table_z_mm:g}",
)  # fmt: skip
STATIONS = SetupField(
    flag="--stations", step=MOUNT, kind=INTEGER, meaning=int, lowest=1, highest=20,
    en="Number of stations", de="Anzahl der Stationen", shown=lambda setup: f"{len(setup.stations.places_mm)}",
)  # fmt: skip
POSITION_SET = SetupField(
    flag="--position-set", step=MOUNT, kind=TEXT, metavar="SET",
    meaning=lambda text: str(Path(text).resolve()) if text.endswith((".csv", ".toml")) else text,
    en="Position set: S1, S2, S3, joined by +, or a position file",
    de="Positionssatz: S1, S2, S3, verbunden mit +, oder eine Positionsdatei",
    option="S1, S2, S3, joined by +, or a position file.",
)  # fmt: skip
TOUCHES = SetupField(
    flag="--touches", step=MOUNT, kind=CHOICE, meaning=int, words=dict.fromkeys(("5", "9", "13", "25")),
    en="Touches of each ball", de="Antastungen je Kugel", option="Touches of each ball: 5, 9, 13 or 25.",
)  # fmt: skip


def _of_length(artefact: ArtefactSetup, text: str) -> str | None:
    """Return `text` if the artefact has a certified length."""
    return None if artefact.calibration.length_mm is None else text


SETUP_FIELDS: tuple[SetupField[Any], ...] = (
    NAME, MACHINE_CLASS, CONTROLLER_KIND, ADDRESS, TRAVEL, SPINDLE, CHAIN, STYLUS, TIP_DIAMETER, STEM, PROBE_DIAMETER,
    RAPID, FEED, ACCELERATION, ARTEFACT, SHAPE, SIZE, BALLS, TILT, HOLDER, BALL_DIAMETER, CALIBRATION, CERTIFIED_LENGTH,
    LENGTH_UNCERTAINTY, PLACEMENT, MOUNT_AT, SHAFT, TABLE_Z, STATIONS, POSITION_SET, TOUCHES,
)  # fmt: skip
"""All fields in the order of the help text."""
FIELDS = {field.name: field for field in SETUP_FIELDS}
"""All fields by name."""
