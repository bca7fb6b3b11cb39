"""Objects at one station: the mount and, if the mount carries an artefact, the true artefact as the
operator placed it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from simulators.scenario import ArtefactTruthSettings, Scenario
from simulators.world.mount import MountPhysics
from simulators.world.noise import generator
from simulators.world.thermal_effects import artefact_bow_mm, bend_balls
from simulators.world.thermal_state import ThermalState
from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.position_set import Pose, mount_pose
from twin.collision.bodies import TABLE, TIP, Body, artefact_bodies, ball_name, mount_bodies, table_body
from twin.collision.collision import Scene
from twin.collision.geometry import Point, point
from twin.collision.swept_volume import SphereCover, cover_turning_bodies


@dataclass(frozen=True, eq=False)
class WorkpieceSnapshot:
    """State of a workpiece at one instant: the true ball centres, the names of the balls, and all bodies around them.

    `pose` is the pose of the artefact; if there are several artefacts, it is the pose of the first. `allowed_contacts`
    are the pairs of stylus tip and ball, which may touch.
    """

    pose: Pose
    balls: tuple[Point, ...]
    ball_names: tuple[str, ...]
    bodies: tuple[Body, ...]
    scene: Scene
    allowed_contacts: frozenset[tuple[str, str]] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "allowed_contacts", frozenset((TIP, name) for name in self.ball_names))


class Workpiece:
    """Mount and true artefact at one station, with the pose of the artefact for given mount angles and temperature.

    The pose and the ball centres are recomputed only if a mount angle changes or if the temperature changes by at least
    1 mK (17 nm of expansion on a long bar). If there are several workpieces, `name_suffix` is appended to the names of
    the bodies of this workpiece.
    """

    def __init__(
        self, scenario: Scenario, mount: MountPhysics, artefact: Artefact | None, station: int, name_suffix: str = ""
    ) -> None:
        settings = scenario.settings
        self.mount = mount
        self.station = station
        self.probe_bodies = scenario.probe.bodies(scenario.frame)
        self._frame = scenario.frame
        self._artefact = artefact
        self._name_suffix = name_suffix
        self._geometry = settings.mount
        self._places = np.array(settings.stations_mm, dtype=np.float64)
        self._temperatures = settings.temperatures
        self._thermal_state = ThermalState(settings.temperatures)
        self._cached: tuple[object, WorkpieceSnapshot] | None = None
        self._cover: SphereCover | None = None
        self._location_mm: Array = self._places[station - 1]
        self._yaw_rad = 0.0

    def place(self, station: int, rng: np.random.Generator, error_mm: float, error_deg: float) -> None:
        """Place the mount at `station` as an operator does, displaced by up to `error_mm` and rotated about the
        vertical by up to `error_deg` from its nominal location.
        """
        self.station = station
        self._location_mm = np.add(self._places[station - 1], _placement_error(error_mm, rng))
        self._yaw_rad = math.radians(error_deg) * float(rng.uniform(-1.0, 1.0))
        self._cached = None

    def shift(self, by_mm: Point, turn_deg: float) -> None:
        """Displace the mount by `by_mm` and rotate it about its azimuth axis by `turn_deg`, as after a knock or a
        careless placement.
        """
        self._location_mm = np.add(self._location_mm, by_mm)
        self._yaw_rad += math.radians(turn_deg)
        self._cached = None

    def carry(self, artefact: Artefact | None) -> None:
        """Replace the artefact on this mount. If `artefact` is None, the mount is left without an artefact."""
        self._artefact = artefact
        self._cached = self._cover = None

    @property
    def hanging(self) -> bool:
        """True if the mount hangs from the table, which is then above it."""
        return self._geometry.hanging

    @property
    def artefact(self) -> Artefact:
        """True artefact on the mount. The property must not be read if the mount carries no artefact."""
        assert self._artefact is not None  # noqa: S101  callers know which mount has the artefact
        return self._artefact

    @property
    def location_mm(self) -> Array:
        """Point where the azimuth axis and the elevation axis of the mount meet, shape (3,), in mm in the workpiece
        frame.
        """
        return self._location_mm

    @property
    def sweep_radius_mm(self) -> float:
        """Largest distance in mm between the location of the mount and any part of the artefact, over all
        mount angles.
        """
        geometry = self._geometry
        if self._artefact is None:
            return geometry.shaft_mm + max(geometry.shaft_radius_mm, geometry.pedestal_radius_mm)
        return geometry.shaft_mm + self._artefact.reach_mm

    @property
    def cover(self) -> SphereCover | None:
        """Set of spheres that encloses all bodies that turn with the mount; None if the mount carries no artefact."""
        if self._cover is None and self._artefact is not None:
            self._cover = cover_turning_bodies(self._artefact, self._geometry)
        return self._cover

    def true_angles_rad(self, instant_s: float) -> tuple[float, float]:
        """Return the true azimuth and elevation of the ball bar in rad at `instant_s`.

        The azimuth includes the small rotation of the mount that results from its placement by the operator.
        """
        azimuth, elevation = self.mount.true_angles_rad(*self.mount.angles_deg(instant_s))
        return azimuth + self._yaw_rad, elevation

    def temperature_c(self, now_s: float) -> float:
        return self._thermal_state.artefact_c(now_s)

    def snapshot(self, now_s: float) -> WorkpieceSnapshot:
        """Return the artefact's pose, the true ball centres in the workpiece frame, and the bodies that can collide
        (the scene) at instant `now_s`.
        """
        bow = round(artefact_bow_mm(self._temperatures, self._thermal_state, now_s), 5)
        # The snapshot is recomputed for a change of 1 mK or of 10 nm of the bow.
        key = (*self.mount.angles_deg(now_s), round(self.temperature_c(now_s), 3), bow)
        if self._cached is None or self._cached[0] != key:
            self._cached = (key, self._compute_snapshot(*key))
        return self._cached[1]

    def _compute_snapshot(
        self, azimuth_deg: float, elevation_deg: float, temperature_c: float, bow: float
    ) -> WorkpieceSnapshot:
        azimuth, elevation = self.mount.true_angles_rad(azimuth_deg, elevation_deg)
        place = self._location_mm + self.mount.wobble_mm(azimuth_deg)
        pose = mount_pose(place, self._geometry, azimuth + self._yaw_rad, elevation)
        mount = (*mount_bodies(self._geometry, place, pose), table_body(self._geometry, place, self._frame))
        if self._artefact is None:
            bodies = self._renamed(mount)
            return WorkpieceSnapshot(pose, (), (), bodies, Scene(self.probe_bodies, bodies))
        centres = pose.apply(bend_balls(self._artefact.at(temperature_c, elevation), bow))
        bodies = self._renamed((*artefact_bodies(self._artefact, pose), *mount))
        names = tuple(f"{ball_name(number)}{self._name_suffix}" for number in range(self._artefact.count))
        scene = Scene(self.probe_bodies, bodies)
        return WorkpieceSnapshot(pose, tuple(point(centre) for centre in centres), names, bodies, scene)

    def _renamed(self, bodies: tuple[Body, ...]) -> tuple[Body, ...]:
        if not self._name_suffix:
            return bodies
        return tuple(
            body if body.name == TABLE else replace(body, name=f"{body.name}{self._name_suffix}") for body in bodies
        )


def true_artefact(certified: Artefact, settings: ArtefactTruthSettings, name: str = "artefact") -> Artefact:
    """Return a true artefact whose deviations from its certificate are drawn at random from the uncertainties that the
    certificate states, multiplied by the factors in `settings`.

    `name` selects the random numbers; each name gives a different artefact.
    """
    rng = generator(settings.seed, name)
    # With C = V Λ Vᵀ, the vector V √Λ u has the covariance C if u is unit normal. Rounding can make the eigenvalues of
    # a singular C slightly negative.
    values, vectors = np.linalg.eigh(certified.covariance)
    spread = vectors @ (np.sqrt(np.maximum(values, 0.0)) * rng.standard_normal(values.size))
    cte = certified.cte_standard_uncertainty_per_k * float(rng.standard_normal())
    return replace(
        certified,
        balls=certified.balls + settings.certificate_error * spread.reshape(-1, 3),
        cte_per_k=certified.cte_per_k + settings.cte_error * cte,
    )


def _placement_error(error_mm: float, rng: np.random.Generator) -> Array:
    """Return the placement error (3,) in mm.

    The error in height is ten times smaller, because the mount is on the table.
    """
    return np.asarray(error_mm * rng.uniform(-1.0, 1.0, 3) * (1.0, 1.0, 0.1))
