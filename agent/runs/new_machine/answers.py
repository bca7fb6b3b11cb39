"""Answers about a new machine: options, what the controller reports, answers of a person, proposals."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

from agent.files import read_text, translated
from agent.model_files import load_artefact
from agent.planning.setup_files.new_setup import ARTEFACT_FILE, NewSetup
from agent.planning.setup_proposal.artefact_geometry import nominal_length_mm
from agent.planning.setup_proposal.artefact_setup import (
    CERTIFICATE,
    LENGTH,
    ArtefactSetup,
    Calibration,
    check_balls,
    nominal_artefact,
    propose_shape,
    propose_size,
    smaller_size,
)
from agent.planning.setup_proposal.choices import CALIBRATIONS, SHAPES, SPINDLES
from agent.planning.setup_proposal.controller_setup import CONTROLLERS, MODBUS, SERIAL, SIMULATED, ControllerSetup
from agent.planning.setup_proposal.machine_class import MACHINE_CLASSES, MachineClass
from agent.planning.setup_proposal.machine_setup import Limits, MachineSetup, Triple, check_travel
from agent.planning.setup_proposal.spindle import parse_spindle
from agent.planning.setup_proposal.station_setup import PROPOSED, STATED, StationSetup, propose_stations
from agent.runs.new_machine.questions import SetupQuestions
from drivers.clock import RealClock
from drivers.errors import ConfigurationError, DeviceError, InputError
from drivers.registry import DeviceContext, create_device
from drivers.roles import AxisLimits, Machine
from twin.errors import DataError
from twin.machine.kinematic_chain import AXES, parse_chain

Value = TypeVar("Value")
ThreeLimits = tuple[Limits, Limits, Limits]

READ = "read from the controller"
S_PER_MIN = 60.0


@dataclass(frozen=True)
class InitOptions:
    """Options of `volcal init` as typed; None if an option was not given."""

    name: str | None = None
    machine_class: str | None = None
    controller: str | None = None
    address: str | None = None
    travel: tuple[str, str, str] | None = None
    spindle: str | None = None
    chain: str | None = None
    stylus: float | None = None
    tip_diameter: float | None = None
    stem: float | None = None
    probe_diameter: float | None = None
    rapid: Triple | None = None
    feed: Triple | None = None
    acceleration: Triple | None = None
    artefact: Path | None = None
    shape: str | None = None
    size: float | None = None
    balls: int | None = None
    tilt: float | None = None
    holder: float | None = None
    ball_diameter: float | None = None
    calibration: str | None = None
    certified_length: float | None = None
    length_uncertainty: float | None = None
    mount_at: Triple | None = None
    shaft: float | None = None
    table_z: float | None = None
    stations: int | None = None
    position_set: str | None = None
    touches: int | None = None


@dataclass
class SetupAnswers:
    """Collects all answers about one machine. `directory` is the directory of the machine, and `notes` are remarks for
    the person who typed the command."""

    options: InitOptions
    questions: SetupQuestions
    directory: Path
    notes: list[str] = field(default_factory=list)
    read: Callable[[ControllerSetup, Path], AxisLimits] | None = None
    """Source of what the controller reports, by default the controller itself."""

    def collect(self) -> NewSetup:
        """Return the set-up of the machine. Raises InputError, which names the option, if an answer is missing or
        impossible."""
        kind = self._machine_class()
        controller = self._controller()
        machine = self._machine(kind, controller, self._reading(controller))
        artefact, files = self._artefact(machine)
        stations = self._stations(machine, artefact)
        return NewSetup(machine, controller, artefact, stations, files, self._position_set(), self.options.touches)

    def with_smaller_artefact(self, setup: NewSetup) -> NewSetup | None:
        """Return the set-up with a smaller artefact and its stations, or None if a person chose its size or none is
        smaller."""
        origins = setup.artefact.origins
        size = smaller_size(setup.artefact) if origins.get("size_mm", STATED) != STATED else None
        if size is None:
            return None
        nominal = nominal_artefact(setup.artefact.shape, size)
        names = ("balls", "tilt_deg", "holder_mm", "diameter_mm")
        stated = {name: getattr(setup.artefact, name) for name in names if origins.get(name) == STATED}
        artefact = replace(nominal, **stated, calibration=setup.artefact.calibration, origins=origins)
        return replace(setup, artefact=artefact, stations=self._stations(setup.machine, artefact))

    # ------------------------------------------------------------------ machine

    def _machine_class(self) -> MachineClass:
        described = "; ".join(f"{kind.name}: {kind.description}" for kind in MACHINE_CLASSES.values())
        name = self.options.machine_class or self.questions.ask(
            "--class", f"Class of the machine ({described})", str, choices=tuple(MACHINE_CLASSES)
        )
        return MACHINE_CLASSES[name]

    def _controller(self) -> ControllerSetup:
        kind = self.options.controller or self.questions.ask(
            "--controller", "Controller of the machine", str, proposal=SIMULATED, choices=CONTROLLERS
        )
        address = self.options.address
        if address is None and kind in (MODBUS, SERIAL):
            asked = "HOST or HOST:PORT of its Modbus TCP server" if kind == MODBUS else "Name of its serial port"
            address = self.questions.ask("--address", asked, str)
        with translated(InputError):
            return ControllerSetup.of(kind, address)

    def _reading(self, controller: ControllerSetup) -> AxisLimits | None:
        """Return the travel and dynamics that the controller reports, None if there is no controller to be asked.

        If the controller cannot be reached, this is noted, and the travel must be stated.
        """
        if controller.is_simulated:
            return None
        try:
            return (self.read or read_axis_limits)(controller, self.directory)
        except (DeviceError, ConfigurationError) as error:
            self.notes.append(f"the controller was not reached, so nothing was read from it: {error}")
            return None

    def _machine(self, kind: MachineClass, controller: ControllerSetup, read: AxisLimits | None) -> MachineSetup:
        origins: dict[str, str] = {}
        typical = f"typical of class {kind.name}"
        limits = self._limits(read, origins)
        x, y, z = ((low, high) for low, high in limits)
        travel = (x[1] - x[0], y[1] - y[0], z[1] - z[0])
        options = self.options
        spindle = self._chosen(
            origins, "spindle", options.spindle, "--spindle", "Spindle direction, from the spindle to the stylus",
            parse_spindle, kind.spindle, typical, choices=SPINDLES,
        )  # fmt: skip
        chain = self._chosen(
            origins, "chain", options.chain, "--chain", "Kinematic chain from the tool to the workpiece",
            lambda text: str(parse_chain(text)), kind.chain(spindle, travel), typical,
        )  # fmt: skip
        stylus = self._chosen(
            origins, "stylus_mm", None if options.stylus is None else str(options.stylus), "--stylus",
            "Distance from the ram reference to the stylus centre in mm", _length, f"{kind.stylus_mm:g}", typical,
        )  # fmt: skip
        rapid = _dynamics(
            origins,
            "rapid_mm_per_min",
            options.rapid,
            _scaled(read.rapid_mm_per_s) if read else None,
            kind.rapid_mm_per_min,
        )
        acceleration = _dynamics(
            origins,
            "acceleration_mm_per_s2",
            options.acceleration,
            read.acceleration_mm_per_s2 if read else None,
            kind.acceleration_mm_per_s2,
        )
        feed = _dynamics(origins, "feed_mm_per_min", options.feed, None, kind.feed_mm_per_min)
        name = options.name or self.questions.ask(
            "--name", "Name of the machine", str, proposal=self.directory.resolve().name or kind.name
        )
        with translated(InputError):
            return MachineSetup(
                name, kind, limits, spindle, chain, stylus, rapid, feed, acceleration, origins, self._probe_sizes()
            )

    def _probe_sizes(self) -> dict[str, float]:
        """Return the stated dimensions of the probe by the name of the key of section `[probe]`."""
        options = self.options
        stated = {
            "tip_radius_mm": _half(options.tip_diameter),
            "stem_length_mm": options.stem,
            "body_radius_mm": _half(options.probe_diameter),
        }
        return {key: value for key, value in stated.items() if value is not None}

    def _limits(self, read: AxisLimits | None, origins: dict[str, str]) -> ThreeLimits:
        if self.options.travel is not None:
            origins["limits_mm"] = STATED
            with translated(InputError, option="--travel"):
                return parse_travel(self.options.travel)
        if read is not None and all(map(math.isfinite, (*read.lower_mm, *read.upper_mm))):
            origins["limits_mm"] = READ
            return read_limits(read)
        origins["limits_mm"] = STATED
        return self.questions.ask(
            "--travel",
            "Travel of X, Y and Z in mm, separated by blanks (a length, or LOWEST:HIGHEST axis position)",
            lambda text: parse_travel(text.split()),
        )

    def _chosen(
        self,
        origins: dict[str, str],
        key: str,
        typed: str | None,
        option: str,
        question: str,
        read: Callable[[str], Value],
        proposal: str,
        proposed: str,
        *,
        choices: tuple[str, ...] = (),
    ) -> Value:
        """Return the value of an option or the answer to a question, and record its origin under `key`."""
        if typed is not None:
            origins[key] = STATED
            with translated(InputError, option=option):
                return read(typed)
        value = self.questions.ask(option, question, read, proposal=proposal, choices=choices)
        origins[key] = proposed if str(value) == str(read(proposal)) else STATED
        return value

    # ------------------------------------------------------------------ artefact, mount and positions

    def _artefact(self, machine: MachineSetup) -> tuple[ArtefactSetup, Mapping[str, str] | None]:
        """Return the dimensions of the artefact, and the texts of its files if it is not a nominal one."""
        options = self.options
        if options.artefact is not None:
            return _artefact_of_file(options.artefact)
        origins: dict[str, str] = {}
        shape = self._chosen(
            origins, "shape", options.shape, "--shape", "Shape of the artefact (a file of one: option --artefact)",
            str, propose_shape(machine), PROPOSED, choices=SHAPES,
        )  # fmt: skip
        size = self._chosen(
            origins, "size_mm", _text(options.size), "--size",
            "Length of the bar between its end balls, side of the plate between its corner balls, or edge, in mm",
            _length, f"{propose_size(shape, machine):g}", f"{PROPOSED} from the travel",
        )  # fmt: skip
        proposed = nominal_artefact(shape, size)
        diameter = self._chosen(
            origins, "diameter_mm", _text(options.ball_diameter), "--ball-diameter", "Diameter of its balls in mm",
            _length, f"{proposed.diameter_mm:g}", PROPOSED,
        )  # fmt: skip
        balls = self._chosen(
            origins, "balls", _text(options.balls), "--balls", "Number of its balls",
            lambda text: check_balls(shape, int(_length(text))), f"{proposed.balls}", PROPOSED,
        )  # fmt: skip
        for key, value in (("tilt_deg", options.tilt), ("holder_mm", options.holder)):
            origins[key] = PROPOSED if value is None else STATED
        artefact = replace(
            proposed,
            balls=balls,
            tilt_deg=proposed.tilt_deg if options.tilt is None else options.tilt,
            holder_mm=options.holder or proposed.holder_mm,
            diameter_mm=diameter,
            origins=origins,
        )
        return replace(artefact, calibration=self._calibration(artefact)), None

    def _calibration(self, artefact: ArtefactSetup) -> Calibration:
        options = self.options
        implied = LENGTH if options.certified_length is not None else None
        kind = (
            options.calibration
            or implied
            or self.questions.ask(
                "--calibration",
                "What is certified: all ball centres (certificate), the length between two balls (length), or none",
                str,
                proposal=CERTIFICATE,
                choices=CALIBRATIONS,
            )
        )
        if kind != LENGTH:
            return Calibration(kind)
        origins: dict[str, str] = {}
        length = self._chosen(
            origins, "length", _text(options.certified_length), "--certified-length",
            "Certified distance in mm of the end balls (plate: opposite corners; tetrahedron: corners 0 and 1)",
            _length, f"{nominal_length_mm(artefact):.4f}", PROPOSED,
        )  # fmt: skip
        uncertainty = self._chosen(
            origins, "uncertainty", _text(options.length_uncertainty), "--length-uncertainty",
            "Its standard uncertainty in µm (k = 1)", _length, "1", PROPOSED,
        )  # fmt: skip
        return Calibration(kind, length, uncertainty)

    def _stations(self, machine: MachineSetup, artefact: ArtefactSetup) -> StationSetup:
        options = self.options
        return propose_stations(
            machine,
            artefact,
            count=options.stations,
            first_mm=options.mount_at,
            shaft_mm=options.shaft,
            table_z_mm=options.table_z,
        )

    def _position_set(self) -> str | None:
        name = self.options.position_set
        return str(Path(name).resolve()) if name and name.endswith((".csv", ".toml")) else name


def parse_travel(texts: tuple[str, ...] | list[str]) -> ThreeLimits:
    """Return the lowest and highest axis position of X, Y and Z, each written as a length or as LOWEST:HIGHEST.

    Raises DataError if there are not three travels or if one is not a range of numbers.
    """
    if len(texts) != len(AXES):
        raise DataError(f"{len(texts)} travels, three are needed", hint="state X, Y and Z, such as 800 500 400")
    x, y, z = limits = tuple(_limits_of(text) for text in texts)
    for axis, (low, high) in zip(AXES, limits, strict=True):
        check_travel(axis, low, high)
    return x, y, z


def read_axis_limits(controller: ControllerSetup, directory: Path) -> AxisLimits:
    """Connect to the controller, and return the travel and the dynamics of its axes. Nothing is moved or written.

    Raises DeviceError if the controller cannot be reached.
    """
    context = DeviceContext("cnc", RealClock(), directory)
    device = create_device(controller.driver, controller.connection_options(), context)
    try:
        device.open()
        if not isinstance(device, Machine):
            raise ConfigurationError(f"driver {controller.driver} is not a machine", key="controller")
        return device.limits()
    finally:
        device.close()


def read_limits(read: AxisLimits) -> ThreeLimits:
    """Return the lowest and highest axis position of X, Y and Z that a controller reported."""
    x, y, z = zip(read.lower_mm, read.upper_mm, strict=True)
    return x, y, z


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
    if not 0.0 < value < float("inf"):
        raise DataError(f"'{text}' is not a length in mm")
    return value


def _text(value: float | None) -> str | None:
    return None if value is None else f"{value:.10g}"


def _half(diameter: float | None) -> float | None:
    return None if diameter is None else 0.5 * diameter


def _dynamics(origins: dict[str, str], key: str, stated: Triple | None, read: Triple | None, typical: float) -> Triple:
    if stated is not None:
        if not all(0.0 < value < math.inf for value in stated):
            values = " ".join(f"{value:g}" for value in stated)
            option = f"--{key.partition('_')[0]}"
            raise InputError(f"'{values}' are not three values above 0, for X, Y and Z", option=option)
        origins[key] = STATED
        return stated
    if read is not None and all(map(math.isfinite, read)):
        origins[key] = READ
        return read
    origins[key] = "typical of the class, not read from the controller"
    return typical, typical, typical


def _scaled(rapid_mm_per_s: Triple) -> Triple:
    x, y, z = rapid_mm_per_s
    return S_PER_MIN * x, S_PER_MIN * y, S_PER_MIN * z


def _artefact_of_file(path: Path) -> tuple[ArtefactSetup, Mapping[str, str]]:
    """Return the dimensions of the artefact in a file, and the texts to be copied: the file itself and, under its own
    name, the covariance file that it names."""
    artefact = load_artefact(path)
    text = read_text(path)
    copied = {ARTEFACT_FILE: text}
    covariance = tomllib.loads(text).get("covariance_file")
    if covariance is not None:
        if Path(covariance).name != covariance:
            raise InputError(
                "the covariance file is in another directory",
                hint="put it beside the artefact file",
                file=str(path),
                key="covariance_file",
            )
        copied[covariance] = read_text(path.parent / covariance)
    described = ArtefactSetup(
        shape="",
        size_mm=2.0 * artefact.half_length_mm,
        balls=artefact.count,
        tilt_deg=0.0,
        holder_mm=artefact.holder_length_mm,
        diameter_mm=artefact.ball_diameter_mm,
    )
    return described, copied
