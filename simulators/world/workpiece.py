"""What stands on the table: the true artefact on its mount, at the place where the operator put it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from drivers.errors import CommandRejected
from simulators.scenario import ArtefactTruthSettings, MountBehaviour, Scenario
from simulators.world.mount import MountPhysics
from simulators.world.noise import generator
from simulators.world.thermal import bow_mm, bowed
from simulators.world.warming import Warming
from twin.arrays import Array
from twin.artefact import Artefact
from twin.bodies import artefact_bodies, mount_bodies
from twin.collision import Scene
from twin.geometry import Point, point
from twin.position_set import Pose, mount_pose


@dataclass(frozen=True, eq=False)
class Standing:
    """Everything that a motion needs to know of one pose: true ball centres, and the bodies around them."""

    pose: Pose
    balls: tuple[Point, ...]
    scene: Scene


class Workpiece:
    """True pose of the artefact for mount angles and temperature; rebuilt only when one of them changes, the
    temperature by 1 mK (17 nm of a long bar)."""

    def __init__(self, scenario: Scenario, mount: MountPhysics) -> None:
        settings = scenario.settings
        self.artefact = true_artefact(scenario.artefact, settings.artefact_truth)
        self.mount = mount
        self._geometry = settings.mount
        self.probe_bodies = settings.probe.bodies()
        self._places = np.array(settings.stations_mm, dtype=np.float64)
        self._behaviour = settings.mount_behaviour
        self._seed = settings.seed
        self._temperatures = settings.temperatures
        self._warming = Warming(settings.temperatures)
        self._placements = 0
        self._cached: tuple[object, Standing] | None = None
        self.station = 0
        self.place(settings.standing_at)

    def place(self, station: int) -> None:
        """The operator's hand: never exactly the nominal place, and a little turned."""
        if not 1 <= station <= len(self._places):
            raise CommandRejected(f"there is no station {station}", hint=f"stations are 1 to {len(self._places)}")
        rng = generator(self._seed, f"placement {self._placements}")
        self._placements += 1
        self.station = station
        self._place_mm: Array = np.add(self._places[station - 1], _hand(self._behaviour, rng))
        self._yaw_rad = math.radians(self._behaviour.place_error_deg) * float(rng.uniform(-1.0, 1.0))
        self._cached = None

    @property
    def place_mm(self) -> Array:
        """(3,) where the azimuth axis stands, at the height of the bar's middle."""
        return self._place_mm

    @property
    def sweep_radius_mm(self) -> float:
        """No part of the artefact is farther from the place, whatever the mount's angles."""
        geometry = self._geometry
        reach = float(np.linalg.norm(self.artefact.balls, axis=1).max()) + geometry.shaft_mm
        return reach + max(geometry.bar_overhang_mm, self.artefact.ball_radius_mm) + geometry.bar_radius_mm

    def temperature_c(self, now_s: float) -> float:
        return self._warming.artefact_c(now_s)

    def standing(self, now_s: float) -> Standing:
        """Pose, true ball centres (workpiece frame) and collision scene at an instant."""
        bow = round(bow_mm(self._temperatures, self._warming, now_s), 5)
        key = (*self.mount.angles_deg(now_s), round(self.temperature_c(now_s), 3), bow)
        if self._cached is None or self._cached[0] != key:
            self._cached = (key, self._stand(*key))
        return self._cached[1]

    def _stand(self, azimuth_deg: float, elevation_deg: float, temperature_c: float, bow: float) -> Standing:
        azimuth, elevation = self.mount.true_angles_rad(azimuth_deg, elevation_deg)
        place = self._place_mm + self.mount.wobble_mm(azimuth_deg)
        pose = mount_pose(place, self._geometry, azimuth + self._yaw_rad, elevation)
        centres = pose.applied(bowed(self.artefact.at(temperature_c, elevation), bow))
        bodies = artefact_bodies(self.artefact, self._geometry, pose)
        around = (*bodies, *mount_bodies(self._geometry, place, pose))
        return Standing(pose, tuple(point(centre) for centre in centres), Scene(self.probe_bodies, around))


def true_artefact(certified: Artefact, settings: ArtefactTruthSettings) -> Artefact:
    """An artefact whose certificate is wrong within its own uncertainty."""
    rng = generator(settings.seed, "artefact")
    values, vectors = np.linalg.eigh(certified.covariance)
    spread = vectors @ (np.sqrt(np.maximum(values, 0.0)) * rng.standard_normal(values.size))
    cte = certified.cte_standard_uncertainty_per_k * float(rng.standard_normal())
    return replace(
        certified,
        balls=certified.balls + settings.certificate_error * spread.reshape(-1, 3),
        cte_per_k=certified.cte_per_k + settings.cte_error * cte,
    )


def _hand(behaviour: MountBehaviour, rng: np.random.Generator) -> Array:
    """(3,) mm; the table carries the mount, so its height is ten times as sure as its place."""
    return np.asarray(behaviour.place_error_mm * rng.uniform(-1.0, 1.0, 3) * (1.0, 1.0, 0.1))
