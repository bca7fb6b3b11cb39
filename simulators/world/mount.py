"""Rotary mount: its two axes with their motion laws, and the true orientation of the ball bar, including the errors of
the mount.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from drivers.errors import CommandRejected
from simulators.scenario import MountBehaviour
from simulators.world.noise import generator
from twin.arrays import Array
from twin.collision.motion_law import MotionLaw, trapezoid

AZIMUTH, ELEVATION = "azimuth", "elevation"
LIMITS_DEG = {AZIMUTH: 180.0, ELEVATION: 95.0}


class RotaryAxis:
    """One rotary axis of a mount. Its angles are encoder readings in degrees."""

    def __init__(self, behaviour: MountBehaviour, start_deg: float = 0.0) -> None:
        self._behaviour = behaviour
        self._angle = start_deg
        self._law: MotionLaw | None = None
        self._direction = 1.0
        self._end_deg = start_deg
        self.at_rest_s = -math.inf
        """Instant in s from which the axis is at rest, if nothing intervenes."""

    def position_deg(self, now_s: float) -> float:
        if self._law is None or now_s >= self.at_rest_s:
            return self._end_deg
        return self._angle + self._direction * self._law.distance_at(now_s)

    def turn(self, angle_deg: float, speed_deg_per_s: float | None, now_s: float) -> None:
        # A turn begins where the axis is, even in the middle of another turn; its speed then starts from zero again.
        self._angle = self.position_deg(now_s)
        travel_deg = angle_deg - self._angle
        speed = min(speed_deg_per_s or math.inf, self._behaviour.speed_deg_per_s)
        self._direction = math.copysign(1.0, travel_deg)
        self._follow(trapezoid(now_s, abs(travel_deg), speed, self._behaviour.acceleration_deg_per_s2))

    def halt(self, now_s: float) -> None:
        if self._law is not None and now_s < self.at_rest_s:
            self._follow(self._law.braked_from(now_s, self._behaviour.acceleration_deg_per_s2))

    def _follow(self, law: MotionLaw) -> None:
        self._law, self.at_rest_s = law, law.end_s
        self._end_deg = self._angle + self._direction * law.end_distance


class MountPhysics:
    """Both rotary axes (azimuth and elevation) of one mount.

    The function `on_turn` is called whenever a motion of either axis begins or changes. Mounts with different names
    have different true errors.
    """

    def __init__(
        self,
        behaviour: MountBehaviour,
        seed: int,
        on_turn: Callable[[], None],
        *,
        name: str = "mount",
        start_deg: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        self._axes = {
            axis: RotaryAxis(behaviour, angle) for axis, angle in zip((AZIMUTH, ELEVATION), start_deg, strict=True)
        }
        self._on_turn = on_turn
        self._errors = _MountErrors(behaviour, seed, name)
        # both axes turning at once: at most the sum of their speeds, whatever the angle between them
        self._fastest = 2.0 * behaviour.speed_deg_per_s
        self.now_s = 0.0

    def begin_turn(self, axis: str, angle_deg: float, speed_deg_per_s: float | None = None) -> None:
        """Start a turn of `axis` to `angle_deg`, even if the axis is already moving.

        Raises CommandRejected if the angle is outside the axis limits or if the speed is not positive.
        """
        limit = LIMITS_DEG[axis]
        # Written as a negation, so that NaN is refused too.
        if not abs(angle_deg) <= limit:
            raise CommandRejected(f"{axis} {angle_deg}° is outside ±{limit}°", device="mount")
        if speed_deg_per_s is not None and not speed_deg_per_s > 0.0:
            raise CommandRejected(f"speed must be positive, got {speed_deg_per_s}°/s", device="mount")
        self._axes[axis].turn(angle_deg, speed_deg_per_s, self.now_s)
        self._on_turn()

    def position_deg(self, axis: str, instant_s: float | None = None) -> float:
        """Return the encoder reading of `axis` in degrees, at present or at `instant_s`.

        The reading at a future instant is valid only if no other command changes the motion.
        """
        return self._axes[axis].position_deg(self.now_s if instant_s is None else instant_s)

    def moving(self, axis: str) -> bool:
        return self.turn_ends_s(axis) is not None

    def turn_ends_s(self, axis: str) -> float | None:
        at_rest_s = self._axes[axis].at_rest_s
        return at_rest_s if self.now_s < at_rest_s else None

    @property
    def max_speed_deg_per_s(self) -> float:
        """Upper bound in °/s of the angular speed of the artefact if both axes move at once."""
        return self._fastest

    @property
    def settled_s(self) -> float:
        """Instant in s at which both axes will be at rest if no other command intervenes; the present instant `now_s`
        if both are already at rest.
        """
        return max(self.now_s, *(axis.at_rest_s for axis in self._axes.values()))

    def halt(self, axis: str | None = None) -> None:
        """Brake the rotary axis `axis`, or both axes if `axis` is None."""
        for name in (axis,) if axis is not None else tuple(self._axes):
            self._axes[name].halt(self.now_s)
        self._on_turn()

    def angles_deg(self, instant_s: float | None = None) -> tuple[float, float]:
        """Return the encoder readings of azimuth and elevation in degrees, at present or at `instant_s`.

        The readings at a future instant are valid only if no other command changes the motion.
        """
        instant_s = self.now_s if instant_s is None else instant_s
        return self._axes[AZIMUTH].position_deg(instant_s), self._axes[ELEVATION].position_deg(instant_s)

    def true_angles_rad(self, azimuth_deg: float, elevation_deg: float) -> tuple[float, float]:
        """Return the true azimuth and elevation of the ball bar in rad, including the errors of the mount, for the
        given encoder readings.
        """
        return self._errors.angles_rad(azimuth_deg, elevation_deg)

    def wobble_mm(self, azimuth_deg: float) -> Array:
        """Return the displacement of the azimuth axis by its wobble, shape (3,), in mm, at the given encoder reading of
        the azimuth.
        """
        return self._errors.wobble_mm(azimuth_deg)


class _MountErrors:
    """Repeatable errors of the mount.

    Index errors have one and two periods per turn, wobble has one period per turn.
    """

    def __init__(self, behaviour: MountBehaviour, seed: int, name: str) -> None:
        rng = generator(seed, name)
        self._index_deg = behaviour.index_error_deg * rng.uniform(-1.0, 1.0, (2, 2))
        self._phase = rng.uniform(0.0, 2.0 * math.pi, 3)
        self._wobble_mm = behaviour.wobble_um * 1e-3

    def angles_rad(self, azimuth_deg: float, elevation_deg: float) -> tuple[float, float]:
        azimuth, elevation = math.radians(azimuth_deg), math.radians(elevation_deg)
        first, second = (
            # The phases 1 and 2 rad are arbitrary; the amplitudes are random.
            math.radians(one * math.sin(angle + 1.0) + two * math.sin(2.0 * angle + 2.0))
            for angle, (one, two) in zip((azimuth, elevation), self._index_deg.tolist(), strict=True)
        )
        return azimuth + first, elevation + second

    def wobble_mm(self, azimuth_deg: float) -> Array:
        return np.asarray(self._wobble_mm * np.sin(math.radians(azimuth_deg) + self._phase))
