"""What stands on the table at one mount: the true artefact, if it carries one, where the operator put it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from simulators.scenario import ArtefactTruthSettings, MountBehaviour, Scenario
from simulators.world.mount import MountPhysics
from simulators.world.noise import generator
from simulators.world.thermal_effects import bow_mm, bowed
from simulators.world.thermal_state import ThermalState
from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.position_set import Pose, mount_pose
from twin.collision.bodies import TABLE, TIP, Body, artefact_bodies, ball_name, mount_bodies
from twin.collision.collision import Scene
from twin.collision.geometry import Point, point
from twin.collision.swept_volume import SphereCover, cover_turning_bodies


@dataclass(frozen=True, eq=False)
class WorkpieceSnapshot:
    """Everything that a motion needs to know of one instant: true ball centres with their names as bodies, and all
    bodies around; `pose` of the (first) artefact's mount. `allowed_contacts`: pairs of bodies that may touch."""

    pose: Pose
    balls: tuple[Point, ...]
    ball_names: tuple[str, ...]
    bodies: tuple[Body, ...]
    scene: Scene
    allowed_contacts: frozenset[tuple[str, str]] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "allowed_contacts", frozenset((TIP, name) for name in self.ball_names))


class Workpiece:
    """True pose of the artefact for mount angles and temperature; rebuilt only when one of them changes, the
    temperature by 1 mK (17 nm of a long bar). `name_suffix` follows the names of its bodies where there are several."""

    def __init__(
        self, scenario: Scenario, mount: MountPhysics, artefact: Artefact | None, station: int, name_suffix: str = ""
    ) -> None:
        settings = scenario.settings
        self.mount = mount
        self.station = station
        self.probe_bodies = settings.probe.bodies()
        self._artefact = artefact
        self._name_suffix = name_suffix
        self._geometry = settings.mount
        self._places = np.array(settings.stations_mm, dtype=np.float64)
        self._behaviour = settings.mount_behaviour
        self._temperatures = settings.temperatures
        self._warming = ThermalState(settings.temperatures)
        self._cached: tuple[object, WorkpieceSnapshot] | None = None
        self._cover: SphereCover | None = None
        self._location_mm: Array = self._places[station - 1]
        self._yaw_rad = 0.0

    def place(self, station: int, rng: np.random.Generator) -> None:
        """The operator's hand: never exactly the nominal place, and a little turned."""
        self.station = station
        self._location_mm = np.add(self._places[station - 1], _placement_error(self._behaviour, rng))
        self._yaw_rad = math.radians(self._behaviour.place_error_deg) * float(rng.uniform(-1.0, 1.0))
        self._cached = None

    def shift(self, by_mm: Point, turn_deg: float) -> None:
        """Somebody bumps into it, or puts it down carelessly."""
        self._location_mm = np.add(self._location_mm, by_mm)
        self._yaw_rad += math.radians(turn_deg)
        self._cached = None

    def carry(self, artefact: Artefact | None) -> None:
        """From now on this mount holds `artefact`, or nothing."""
        self._artefact = artefact
        self._cached = self._cover = None

    @property
    def artefact(self) -> Artefact:
        """The true one; asking a bare mount for it is a defect."""
        assert self._artefact is not None  # noqa: S101  whoever asks knows where it stands
        return self._artefact

    @property
    def location_mm(self) -> Array:
        """(3,) where the azimuth axis stands, at the height of the bar's middle."""
        return self._location_mm

    @property
    def sweep_radius_mm(self) -> float:
        """No part of the artefact is farther from the place, whatever the mount's angles."""
        geometry = self._geometry
        if self._artefact is None:
            return geometry.shaft_mm + max(geometry.shaft_radius_mm, geometry.pedestal_radius_mm)
        reach = float(np.linalg.norm(self._artefact.balls, axis=1).max()) + geometry.shaft_mm
        return reach + max(geometry.bar_overhang_mm, self._artefact.ball_radius_mm) + geometry.bar_radius_mm

    @property
    def cover(self) -> SphereCover | None:
        """Balls around everything that turns; None where no artefact does."""
        if self._cover is None and self._artefact is not None:
            self._cover = cover_turning_bodies(self._artefact, self._geometry)
        return self._cover

    def true_angles_rad(self, instant_s: float) -> tuple[float, float]:
        """Azimuth, as the artefact was put down, and elevation: those of `mount_pose`."""
        azimuth, elevation = self.mount.true_angles_rad(*self.mount.angles_deg(instant_s))
        return azimuth + self._yaw_rad, elevation

    def temperature_c(self, now_s: float) -> float:
        return self._warming.artefact_c(now_s)

    def snapshot(self, now_s: float) -> WorkpieceSnapshot:
        """Pose, true ball centres (workpiece frame) and collision scene at an instant."""
        bow = round(bow_mm(self._temperatures, self._warming, now_s), 5)
        key = (*self.mount.angles_deg(now_s), round(self.temperature_c(now_s), 3), bow)
        if self._cached is None or self._cached[0] != key:
            self._cached = (key, self._stand(*key))
        return self._cached[1]

    def _stand(self, azimuth_deg: float, elevation_deg: float, temperature_c: float, bow: float) -> WorkpieceSnapshot:
        azimuth, elevation = self.mount.true_angles_rad(azimuth_deg, elevation_deg)
        place = self._location_mm + self.mount.wobble_mm(azimuth_deg)
        pose = mount_pose(place, self._geometry, azimuth + self._yaw_rad, elevation)
        mount = mount_bodies(self._geometry, place, pose)
        if self._artefact is None:
            bodies = self._renamed(mount)
            return WorkpieceSnapshot(pose, (), (), bodies, Scene(self.probe_bodies, bodies))
        centres = pose.apply(bowed(self._artefact.at(temperature_c, elevation), bow))
        bodies = self._renamed((*artefact_bodies(self._artefact, self._geometry, pose), *mount))
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
    """An artefact whose certificate is wrong within its own uncertainty; one of another `name` is wrong otherwise."""
    rng = generator(settings.seed, name)
    values, vectors = np.linalg.eigh(certified.covariance)
    spread = vectors @ (np.sqrt(np.maximum(values, 0.0)) * rng.standard_normal(values.size))
    cte = certified.cte_standard_uncertainty_per_k * float(rng.standard_normal())
    return replace(
        certified,
        balls=certified.balls + settings.certificate_error * spread.reshape(-1, 3),
        cte_per_k=certified.cte_per_k + settings.cte_error * cte,
    )


def _placement_error(behaviour: MountBehaviour, rng: np.random.Generator) -> Array:
    """(3,) mm; the table carries the mount, so its height is ten times as sure as its place."""
    return np.asarray(behaviour.place_error_mm * rng.uniform(-1.0, 1.0, 3) * (1.0, 1.0, 0.1))
