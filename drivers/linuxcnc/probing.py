"""Touches by the probing command G38.3 of LinuxCNC.

The latched position is corrected for the delay between the trip of the probe and the latching of the position.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from drivers.errors import PermissionMissing, ProtocolError
from drivers.linuxcnc.motion import LinuxCncMotion, LinuxCncMotionResult, MdiMotionKind
from drivers.linuxcnc.session import LinuxCncSession
from drivers.linuxcnc.snapshot import Snapshot
from drivers.roles import Miss, ProbeStatus, Touch, Vector
from drivers.straight_move import distance_to_segment_mm, limit_along_direction


class LinuxCncProbing:
    """Touches by the probing command G38.3, which raises no alarm if the probe does not trip.

    The field `tripped` of the snapshot of LinuxCNC's state distinguishes a touch from a miss (no trip).
    """

    def __init__(self, session: LinuxCncSession, motion: LinuxCncMotion) -> None:
        self._session = session
        self._motion = motion

    def status(self) -> ProbeStatus:
        snapshot = self._session.read_snapshot()
        loaded, healthy = self._loaded(snapshot), self._session.probe_healthy(snapshot)
        detail = "" if loaded else f"tool {snapshot.tool} is in the spindle"
        return ProbeStatus(loaded, healthy, snapshot.deflected, detail if healthy else "not healthy: battery or link")

    def touch_towards(self, target_mm: Vector, feed_mm_per_s: float) -> Touch | Miss:
        self._require_usable()
        target = tuple(float(value) for value in target_mm)
        ended = self._motion.run(MdiMotionKind.TOUCH, target, feed_mm_per_s)
        if not ended.snapshot.tripped:
            return Miss(ended.snapshot.position)
        latched = np.array(ended.snapshot.probed)
        distance_mm = distance_to_segment_mm(latched, np.array(ended.start), np.array(target))
        if distance_mm > self._session.settings.latch_tolerance_mm:
            raise ProtocolError(
                f"latched position {ended.snapshot.probed} is {distance_mm:.3f} mm off the commanded path",
                hint="check whether another program uses LinuxCNC at the same time",
                **self._session.where,
            )
        x, y, z = (latched - self._overshoot(ended, target, feed_mm_per_s)).tolist()
        return Touch((x, y, z))

    def _overshoot(self, ended: LinuxCncMotionResult, target: Sequence[float], feed_mm_per_s: float) -> Vector:
        """Return the travel of the axes from the trip to the latch, shape (3,), mm.

        The delay is that of the probe signal plus the time to the servo cycle that reads it, half a cycle on average.
        Overshoot = direction · v · delay. The speed v is the smallest of the programmed feed times its override, the
        limit of the axes along the path, and √(2 a s): the speed after the distance s from the start at acceleration a.
        """
        properties, settings = self._session.properties, self._session.settings
        path = np.subtract(target, ended.start)
        direction = path / np.linalg.norm(path)
        travelled_mm = math.dist(ended.snapshot.probed, ended.start)
        shares = np.abs(direction).tolist()
        speed = min(
            feed_mm_per_s * ended.snapshot.feed_override,
            limit_along_direction(shares, properties.limits.rapid_mm_per_s),
            math.sqrt(2.0 * limit_along_direction(shares, properties.limits.acceleration_mm_per_s2) * travelled_mm),
        )
        late_s = settings.latch_cycles * properties.servo_period_s + settings.probe_delay_s
        return np.asarray(direction * speed * late_s)

    def _require_usable(self) -> None:
        snapshot = self._session.read_snapshot()
        if not (self._loaded(snapshot) and self._session.probe_healthy(snapshot)):
            raise PermissionMissing(
                f"no healthy probe in the spindle (tool {snapshot.tool})", hint="load the probe", **self._session.where
            )

    def _loaded(self, snapshot: Snapshot) -> bool:
        """Return True if the probe is loaded, or if no tool number is configured for it."""
        expected = self._session.settings.probe_tool
        return expected is None or snapshot.tool == expected
