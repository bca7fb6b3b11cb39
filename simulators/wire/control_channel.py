"""Control channel over TCP. It offers the actions of a person at the machine, and facts known only to the simulator,
such as the true errors.

Each request and each answer is one JSON object on one line. Invalid input is answered with ``{"error": ...}``.
"""

from __future__ import annotations

import json
import math
import socket
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import structlog

from drivers.errors import InputError, VolcalError
from drivers.roles import MotionState, Permission, TableImage, Vector
from simulators.scenario import Misplacement
from simulators.wire.instrument_requests import INSTRUMENT_KEYS
from simulators.wire.request_values import number
from simulators.wire.shared_world import SharedWorld, TimeDriven
from simulators.wire.tcp_server import TcpServer, serve_lines
from twin.machine.kinematic_chain import AXES

Answer = dict[str, Any]
FailDrive = Callable[[int, str], None]
"""Function that injects a fault, given the node id and the fault. Raises InputError if either is unknown."""
Measure = Callable[[Answer], Answer]
"""Function that measures the machine with a virtual instrument, given the request. Raises InputError if it is bad."""

REQUEST_KEYS = {
    "place_artefact": ("station",),
    "place_by_hand": ("station", "azimuth_deg", "elevation_deg", "off_mm", "off_deg"),
    "drive": ("node", "fault"),
    "jog": ("axis", "distance_mm"),
    "deflect": ("deflected",),
    **INSTRUMENT_KEYS,
}
"""Keys that each request may have in addition to `do`."""

log = structlog.get_logger()


class VolumetricTruth(Protocol):
    def true_volumetric_error(self, bank: int | None = None) -> tuple[float, float]:
        """Return the true volumetric error in µm with the compensation table of `bank` active, first raw and then
        aligned.

        The aligned error remains after the best-fitting rigid motion is removed. If `bank` is None or 0, no table is
        active.
        """
        ...


class CollisionRecord(Protocol):
    @property
    def time_s(self) -> float: ...

    @property
    def body_a(self) -> str: ...

    @property
    def body_b(self) -> str: ...


class ControllerView(Protocol):
    @property
    def motion(self) -> MotionState: ...

    @property
    def fault(self) -> str: ...

    @property
    def permissions(self) -> Mapping[Permission, bool]: ...

    @property
    def banks(self) -> Mapping[int, TableImage]: ...

    @property
    def active_bank(self) -> int: ...

    def displayed_position(self) -> Vector: ...

    def temperatures(self) -> Mapping[str, float]: ...

    def begin_jog(self, axis: int, distance_mm: float) -> None: ...

    deflected_by_hand: bool


class ControllableWorld(TimeDriven, Protocol):
    """Interface that the control channel needs from a simulated world."""

    @property
    def controller(self) -> ControllerView: ...

    @property
    def truth(self) -> VolumetricTruth: ...

    @property
    def collisions(self) -> Sequence[CollisionRecord]: ...

    def place_artefact(self, station: int) -> None: ...

    def place_by_hand(
        self, station: int, azimuth_deg: float, elevation_deg: float, misplaced: Misplacement | None = None
    ) -> None: ...

    def remove_artefact(self) -> None: ...


class ControlServer:
    """Server of the control channel on `address`, for any number of clients."""

    def __init__(
        self,
        shared: SharedWorld[ControllableWorld],
        address: tuple[str, int],
        fail_drive: FailDrive | None = None,
        measure: Measure | None = None,
    ) -> None:
        self._shared = shared
        self._fail_drive = fail_drive
        self._actions: dict[str, Callable[[Answer], Answer]] = {
            "place_artefact": self._place_artefact,
            "place_by_hand": self._place_by_hand,
            "remove_artefact": self._remove_artefact,
            "truth": self._truth,
            "collisions": self._collisions,
            "status": self._status,
            "drive": self._drive,
            "jog": self._jog,
            "deflect": self._deflect,
            **(dict.fromkeys(INSTRUMENT_KEYS, measure) if measure is not None else {}),
        }
        self._server = TcpServer("control", address, self._serve)
        self.address = self._server.address
        self.start = self._server.start
        self.close = self._server.close

    def _serve(self, connection: socket.socket) -> None:
        serve_lines(connection, lambda line: json.dumps(self.answer(line)).encode())

    def answer(self, line: bytes) -> Answer:
        """Return the answer to one line. Invalid input from a client gives an error answer, not an exception."""
        try:
            request = _parse(line)
            with self._shared.lock:
                return self._action(request)(request)
        except (VolcalError, ValueError) as error:
            log.warning("control request refused", reason=str(error))
            return {"error": str(error)}

    def _action(self, request: Answer) -> Callable[[Answer], Answer]:
        name = request.get("do")
        if not isinstance(name, str) or name not in self._actions:
            raise InputError(f"unknown request {name!r}", key="do", hint=f"one of {', '.join(self._actions)}")
        unknown = sorted(set(request) - {"do", *REQUEST_KEYS.get(name, ())})
        if unknown:
            raise InputError(f"unknown key {unknown[0]!r} in a request to {name}", key=unknown[0])
        return self._actions[name]

    def _place_artefact(self, request: Answer) -> Answer:
        station = _station(request)
        self._shared.world.place_artefact(station)
        log.info("artefact placed", station=station, machine_time_s=self._shared.now)
        return {"done": "place_artefact", "station": station}

    def _place_by_hand(self, request: Answer) -> Answer:
        """Place the artefact by hand. `off_mm` and `off_deg` displace it grossly; without them, it has only the errors
        of the hand that the scenario states."""
        station, angles_deg = _station(request), (_angle(request, "azimuth_deg"), _angle(request, "elevation_deg"))
        off_mm, off_deg = request.get("off_mm", [0.0, 0.0, 0.0]), _angle(request, "off_deg")
        if not (isinstance(off_mm, list) and len(off_mm) == 3):
            raise InputError(f"off_mm must be three numbers, got {off_mm!r}", key="off_mm")
        x, y, z = (number(value, "off_mm") for value in off_mm)
        stated = {"off_mm", "off_deg"} & set(request)
        gross = Misplacement(placement=1, off_mm=(x, y, z), off_deg=off_deg) if stated else None
        self._shared.world.place_by_hand(station, *angles_deg, gross)
        log.info("artefact placed by hand", station=station, angles_deg=angles_deg, machine_time_s=self._shared.now)
        return {"done": "place_by_hand", "station": station}

    def _remove_artefact(self, _: Answer) -> Answer:
        """Take an artefact that is placed by hand off the machine."""
        self._shared.world.remove_artefact()
        log.info("artefact removed", machine_time_s=self._shared.now)
        return {"done": "remove_artefact"}

    def _drive(self, request: Answer) -> Answer:
        """Inject a fault into a drive of a mount, or clear it."""
        node, fault = request.get("node"), request.get("fault")
        if not isinstance(node, int) or isinstance(node, bool) or not isinstance(fault, str):
            raise InputError(f"node must be an integer and fault a string, got {node!r} and {fault!r}", key="node")
        if self._fail_drive is None:
            raise InputError("this simulator has no drives", key="do")
        self._fail_drive(node, fault)
        log.info("drive fault", node=node, fault=fault, machine_time_s=self._shared.now)
        return {"done": "drive", "node": node, "fault": fault}

    def _jog(self, request: Answer) -> Answer:
        """Move one axis, as a person does at the controller's own panel."""
        axis = request.get("axis")
        if axis not in AXES:
            raise InputError(f"axis must be X, Y or Z, got {axis!r}", key="axis")
        distance = number(request.get("distance_mm"), "distance_mm")
        self._shared.world.controller.begin_jog(AXES.index(axis), distance)
        log.info("jog", axis=axis, distance_mm=distance, machine_time_s=self._shared.now)
        return {"done": "jog", "axis": axis, "distance_mm": distance}

    def _deflect(self, request: Answer) -> Answer:
        """Deflect the stylus by hand, or let go of it."""
        deflected = request.get("deflected")
        if not isinstance(deflected, bool):
            raise InputError(f"deflected must be true or false, got {deflected!r}", key="deflected")
        self._shared.world.controller.deflected_by_hand = deflected
        log.info("stylus", deflected_by_hand=deflected, machine_time_s=self._shared.now)
        return {"done": "deflect", "deflected": deflected}

    def _truth(self, _: Answer) -> Answer:
        """Return the true volumetric errors in µm without table, with the active bank, and with every bank that holds a
        table.
        """
        controller = self._shared.world.controller
        banks = {bank: self._volumetric_error(bank) for bank in sorted(controller.banks) if bank}
        bare = self._volumetric_error(None)
        active = controller.active_bank
        return {
            "active_bank": active,
            "bare": bare,
            "active": banks[active] if active else bare,
            "banks": {str(bank): error for bank, error in banks.items()},
        }

    def _volumetric_error(self, bank: int | None) -> Answer:
        raw_um, aligned_um = self._shared.world.truth.true_volumetric_error(bank)
        return {"raw_um": _finite(raw_um), "aligned_um": _finite(aligned_um)}

    def _collisions(self, _: Answer) -> Answer:
        bumps = self._shared.world.collisions
        listed = [{"time_s": b.time_s, "body_a": b.body_a, "body_b": b.body_b} for b in bumps]
        return {"count": len(listed), "collisions": listed}

    def _status(self, _: Answer) -> Answer:
        world = self._shared.world
        controller = world.controller
        return {
            "machine_time_s": world.now,
            "motion": controller.motion.value,
            "fault": controller.fault,
            "position_mm": [float(x) for x in controller.displayed_position()],
            "missing_permissions": [p.value for p, given in controller.permissions.items() if not given],
            "active_bank": controller.active_bank,
            "temperatures_c": dict(controller.temperatures()),
            "collisions": len(world.collisions),
        }


def _station(request: Answer) -> int:
    station = request.get("station")
    if not isinstance(station, int) or isinstance(station, bool):
        raise InputError(f"station must be an integer, got {station!r}", key="station")
    return station


def _angle(request: Answer, key: str) -> float:
    return number(request.get(key, 0.0), key)


def _parse(line: bytes) -> Answer:
    try:
        request = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise InputError(f"not JSON: {error}", hint='send one object per line, for example {"do": "status"}') from error
    if not isinstance(request, dict):
        raise InputError("not a JSON object", hint='send one object per line, for example {"do": "status"}')
    return request


def _finite(value: float) -> float | None:
    """Return `value`, or None if it is not finite, because JSON cannot represent such values."""
    return float(value) if math.isfinite(value) else None
