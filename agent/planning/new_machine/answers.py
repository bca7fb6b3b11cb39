"""Set-up of a new machine from the answers about it: stated, read from the controller, asked or proposed."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from agent.files import read_text, translated
from agent.model_files import load_artefact
from agent.planning.new_machine import fields
from agent.planning.new_machine.artefact_setup import (
    BY_HAND,
    LENGTH,
    ON_MOUNT,
    ArtefactSetup,
    Calibration,
    nominal_artefact,
    smaller_artefacts,
    smaller_size,
)
from agent.planning.new_machine.artefact_text import nominal
from agent.planning.new_machine.controller_setup import MODBUS, SERIAL, ControllerSetup
from agent.planning.new_machine.field import Answers
from agent.planning.new_machine.hand_placement import propose_hand_places
from agent.planning.new_machine.machine_setup import STATED, MachineSetup, Triple
from agent.planning.new_machine.new_setup import ARTEFACT_FILE, NewSetup
from agent.planning.new_machine.station_setup import StationSetup, check_place, propose_stations
from drivers.errors import ConfigurationError, DeviceError, InputError
from drivers.roles import AxisLimits


@dataclass
class SetupAnswers(Answers):
    """Answers about one machine, and remarks (`notes`) for the person who typed the command."""

    notes: list[str] = field(default_factory=list)
    read_limits: Callable[[ControllerSetup, Path], AxisLimits] | None = None
    """Source of what the controller reports, by default the controller itself."""

    def collect(self) -> NewSetup:
        """Return the set-up of the machine, and ask what is not stated in the order of the steps. Raises InputError,
        which names the option, if an answer is missing or impossible."""
        kind = self[fields.MACHINE_CLASS]
        needed = self[fields.CONTROLLER_KIND] in (MODBUS, SERIAL)
        with translated(InputError):
            controller = ControllerSetup.of(
                self[fields.CONTROLLER_KIND], self[fields.ADDRESS] if needed else self.stated(fields.ADDRESS)
            )
        self.limits = self._reported_limits(controller)
        limits, spindle, chain = self[fields.TRAVEL], self[fields.SPINDLE], self[fields.CHAIN]
        stylus, name = self[fields.STYLUS], self[fields.NAME]
        with translated(InputError):
            probe = {
                one.key: self[one]
                for one in (fields.TIP_DIAMETER, fields.STEM, fields.PROBE_DIAMETER)
                if self.states(one)
            }
            machine = MachineSetup(
                name=name,
                kind=kind,
                limits_mm=limits,
                spindle=spindle,
                chain=chain,
                stylus_mm=stylus,
                rapid_mm_per_min=self[fields.RAPID],
                feed_mm_per_min=self[fields.FEED],
                acceleration_mm_per_s2=self[fields.ACCELERATION],
                origins=self.origins,
                stated_probe=probe,
            )
        artefact, files = self._artefact()
        stations = self._stations(machine, artefact)
        if stations.by_hand:
            self.refuse_stated(
                (fields.SHAFT,),
                "has no meaning for an artefact that is placed by hand",
                hint=f"omit it, or state {fields.PLACEMENT.flag} {ON_MOUNT}",
            )
        return NewSetup(
            machine,
            controller,
            artefact,
            stations,
            files,
            self.stated(fields.POSITION_SET),
            self.stated(fields.TOUCHES),
        )

    def with_smaller_artefact(self, setup: NewSetup) -> NewSetup | None:
        """Return the set-up with a smaller artefact and its stations, or None if a person chose its size, one of its
        lengths is certified, or none is smaller."""
        former = setup.artefact
        is_stated = former.origins.get(fields.SIZE.name, STATED) == STATED or former.calibration.length_mm is not None
        size = None if is_stated else smaller_size(former)
        if size is None:
            return None
        names = {
            fields.BALLS.name: "balls",
            fields.TILT.name: "tilt_deg",
            fields.HOLDER.name: "holder_mm",
            fields.BALL_DIAMETER.name: "diameter_mm",
        }
        kept = {key: getattr(former, key) for name, key in names.items() if former.origins[name] == STATED}
        artefact = replace(
            nominal_artefact(former.shape, size), **kept, calibration=former.calibration, origins=former.origins
        )
        return replace(setup, artefact=artefact, stations=self._stations(setup.machine, artefact))

    def fitting_candidates(self, setup: NewSetup) -> Iterator[NewSetup]:
        """Yield the set-up with each proposed artefact that is not larger than its own, the largest first, and then
        with mount and stations as proposed if a person stated something about them."""
        candidates = [
            replace(artefact, calibration=replace(setup.artefact.calibration, length_mm=None))
            for artefact in smaller_artefacts(setup.artefact.shape, setup.artefact.size_mm)
        ]
        stated = (fields.MOUNT_AT, fields.SHAFT, fields.TABLE_Z, fields.STATIONS)
        for as_stated in (True, False) if any(self.states(one) for one in stated) else (True,):
            for artefact in candidates:
                stations = self._stations(setup.machine, artefact, as_stated=as_stated)
                yield replace(setup, artefact=artefact, artefact_files=None, stations=stations)

    def on_travel(self, setup: NewSetup, travel_mm: Triple) -> NewSetup:
        """Return the set-up with its artefact on a machine whose axes are `travel_mm` long, with the same lower ends.
        Everything about the places is proposed, also what is stated of them (`stated_place_flags`)."""
        ends = zip(setup.machine.limits_mm, travel_mm, strict=True)
        x, y, z = ((low, low + length) for (low, _), length in ends)
        machine = replace(setup.machine, limits_mm=(x, y, z))
        stations = self._stations(machine, setup.artefact, as_stated=False)
        return replace(setup, machine=machine, stations=stations)

    def stated_place_flags(self) -> list[str]:
        """Return the stated options about the places of an artefact that is placed by hand."""
        return [one.flag for one in (fields.TABLE_Z, fields.MOUNT_AT, fields.STATIONS) if self.states(one)]

    def _reported_limits(self, controller: ControllerSetup) -> AxisLimits | None:
        """Return the travel and dynamics that the controller reports, None if there is no controller to be asked.

        If the controller cannot be reached, this is noted, and the travel must be stated.
        """
        if controller.is_simulated:
            return None
        try:
            return (self.read_limits or read_axis_limits)(controller, self.directory)
        except (DeviceError, ConfigurationError) as error:
            self.notes.append(f"the controller was not reached, so nothing was read from it: {error}")
            return None

    def _artefact(self) -> tuple[ArtefactSetup, Mapping[str, str] | None]:
        """Return the dimensions of the artefact, and the texts of its files if it is not a nominal one."""
        if self.states(fields.ARTEFACT):
            described = [one for one in fields.SETUP_FIELDS if one.step == fields.ARTEFACT_STEP]
            self.refuse_stated(
                (one for one in described if one is not fields.ARTEFACT),
                f"describes a nominal artefact, but {fields.ARTEFACT.flag} names the file of another",
                hint="omit one of the two; change a value of the artefact in its file",
            )
            return _artefact_of_file(self[fields.ARTEFACT])
        artefact = fields.stated_artefact(self)
        kind = (
            LENGTH
            if self.states(fields.CERTIFIED_LENGTH) and not self.states(fields.CALIBRATION)
            else self[fields.CALIBRATION]
        )
        if kind != LENGTH:
            self.refuse_stated(
                (fields.CERTIFIED_LENGTH, fields.LENGTH_UNCERTAINTY),
                f"has no meaning if the calibration is '{kind}'",
                hint=f"state {fields.CALIBRATION.flag} {LENGTH}, or omit the option",
            )
            return replace(artefact, calibration=Calibration(kind)), None
        calibration = Calibration(kind, self[fields.CERTIFIED_LENGTH], self[fields.LENGTH_UNCERTAINTY])
        return replace(artefact, calibration=calibration), None

    def _stations(self, machine: MachineSetup, artefact: ArtefactSetup, *, as_stated: bool = True) -> StationSetup:
        """Return mount and stations or, for an artefact that is placed by hand, its places. If not `as_stated`, all
        statements about them are left out, except how the artefact is held."""
        first_mm = self.stated(fields.MOUNT_AT) if as_stated else None
        count = self.stated(fields.STATIONS) if as_stated else None
        table_z_mm = self.stated(fields.TABLE_Z) if as_stated else None
        if first_mm is not None:
            with translated(InputError, option=fields.MOUNT_AT.flag):
                check_place(machine, artefact, first_mm)
        if self[fields.PLACEMENT] == BY_HAND:
            return propose_hand_places(
                machine,
                artefact,
                load_artefact(self[fields.ARTEFACT])
                if not artefact.shape
                else nominal(replace(artefact, calibration=Calibration()), machine.spindle),
                count=count,
                first_mm=first_mm,
                table_z_mm=table_z_mm,
            )
        return propose_stations(
            machine,
            artefact,
            count=count,
            first_mm=first_mm,
            shaft_mm=self.stated(fields.SHAFT) if as_stated else None,
            table_z_mm=table_z_mm,
        )


def read_axis_limits(controller: ControllerSetup, directory: Path) -> AxisLimits:
    """Connect to the controller, and return the travel and the dynamics of its axes. Nothing is moved or written.

    Raises DeviceError if the controller cannot be reached.
    """
    device, limits = controller.open(directory)
    device.close()
    return limits


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
