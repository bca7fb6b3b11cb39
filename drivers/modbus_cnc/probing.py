"""Touch-trigger probe of a controller with Modbus registers."""

from __future__ import annotations

import numpy as np

from drivers.errors import ProtocolError
from drivers.modbus_cnc.codes import (
    PROBE_DEFLECTED,
    PROBE_HEALTHY,
    PROBE_LOADED,
    CommandCode,
    MotionOutcome,
)
from drivers.modbus_cnc.motion import ModbusMotion
from drivers.modbus_cnc.registers import StatusImage, Triple
from drivers.modbus_cnc.session import ModbusSession
from drivers.roles import Miss, ProbeStatus, Touch, Vector
from drivers.straight_move import distance_to_segment_mm

_LATCH_RESULTS = {MotionOutcome.TRIPPED: 1, MotionOutcome.MISSED: 2}


class ModbusProbing:
    """Probing with the controller's touch-trigger probe.

    A latched position is accepted only if it carries the sequence number of the touch command and lies on the path of
    the touch.
    """

    def __init__(self, session: ModbusSession, motion: ModbusMotion) -> None:
        self._session = session
        self._motion = motion

    def status(self) -> ProbeStatus:
        bits = self._session.status().probe_bits
        loaded, healthy = bool(bits & PROBE_LOADED), bool(bits & PROBE_HEALTHY)
        detail = "" if loaded and healthy else ("not healthy: battery or link" if loaded else "not loaded")
        return ProbeStatus(loaded, healthy, bool(bits & PROBE_DEFLECTED), detail)

    def touch_towards(self, target_mm: Vector, feed_mm_per_s: float) -> Touch | Miss:
        start, status = self._motion.run(CommandCode.TOUCH, tuple(float(value) for value in target_mm), feed_mm_per_s)
        self._require_own_latch(status)
        if status.outcome is MotionOutcome.MISSED:
            return Miss(status.latched)
        self._require_on_path(status.latched, start, target_mm)
        return Touch(status.latched)

    def _require_own_latch(self, status: StatusImage) -> None:
        if status.latch_sequence != status.motion_sequence:
            raise self._latch_error(
                f"stale latch: it belongs to touch {status.latch_sequence}, not to touch {status.motion_sequence}"
            )
        if status.latch_result != _LATCH_RESULTS[status.outcome]:
            raise self._latch_error(
                f"touch ended as {status.outcome.name.lower()}, but the latch result is {status.latch_result}"
            )

    def _require_on_path(self, latched: Triple, start: Triple, target_mm: Vector) -> None:
        distance_mm = distance_to_segment_mm(np.array(latched), np.array(start), np.asarray(target_mm, float))
        allowed_mm = self._session.settings.latch_tolerance_mm
        if distance_mm > allowed_mm:
            raise self._latch_error(
                f"latched position {latched} is {distance_mm:.3f} mm off the commanded path (allowed {allowed_mm:g} mm)"
            )

    def _latch_error(self, text: str) -> ProtocolError:
        settings = self._session.settings
        offset = self._session.layouts.status.offset("latch_sequence")
        return ProtocolError(
            text,
            hint="check how the controller latches the position at the trip",
            register=settings.blocks.status + offset,
            **self._session.where,
        )
