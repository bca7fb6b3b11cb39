"""Bodies of the artefact and the mount in the poses of one run, relative to the location of the mount, and the volumes
that they sweep while the mount turns."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.collision.accessibility import measuring_scene
from twin.collision.bodies import ball_name
from twin.collision.free_paths import PrefilteredScene
from twin.collision.geometry import Point, Shape, point
from twin.collision.measuring_layout import MeasuringLayout
from twin.collision.probe_geometry import ProbeGeometry
from twin.collision.swept_volume import SphereCover, TurnSweep, cover_turning_bodies, turn_sweep


@dataclass(frozen=True)
class ArtefactPose:
    """Nominal pose of the artefact. It consists of the two angles of the mount that holds it (azimuth and elevation)
    and of the mount's location `across_mm` (3,) in the workpiece frame, without its coordinate along the station axis,
    which is 0.

    `station` is the station's number if other mounts or artefacts stand in the workspace. It is 0 if the paths are the
    same at all stations.
    """

    azimuth_deg: float
    elevation_deg: float
    across_mm: Point
    station: int = 0


@dataclass(eq=False)
class PosedBodies:
    """Bodies and ball centres in one pose, relative to the location of the mount. The centres are stored as an array
    (N, 3) and as tuples."""

    centres: Array
    centre_points: Sequence[Point]
    prefiltered: PrefilteredScene


@dataclass(frozen=True, eq=False)
class ArtefactBodies:
    """Bodies of `layout` in every pose that is asked for. Each is computed once.

    `turn_clearance_mm` is the clearance of the probe from everything that the mount turns.
    """

    layout: MeasuringLayout
    turn_clearance_mm: float
    _covers: dict[int, SphereCover] = field(default_factory=dict, init=False, repr=False)
    _posed_cache: dict[ArtefactPose, PosedBodies] = field(default_factory=dict, init=False, repr=False)
    _sweeps: dict[object, TurnSweep] = field(default_factory=dict, init=False, repr=False)

    def cover(self, pose: ArtefactPose) -> SphereCover:
        """Return spheres that cover all bodies that turn with the mount."""
        if pose.station not in self._covers:
            self._covers[pose.station] = cover_turning_bodies(self._artefact(pose), self.layout.mount)
        return self._covers[pose.station]

    def _artefact(self, pose: ArtefactPose) -> Artefact:
        return self.layout.artefact_at(pose.station)

    @property
    def _probe(self) -> ProbeGeometry:
        """Probe with a stem at least as thick as the tip, so that the tip can always withdraw along the stylus."""
        probe = self.layout.probe
        return replace(probe, stem_radius_mm=max(probe.stem_radius_mm, probe.tip_radius_mm))

    def posed(self, pose: ArtefactPose) -> PosedBodies:
        """Return the bodies in `pose`."""
        if pose not in self._posed_cache:
            location_mm = self.layout.location(pose.station) if pose.station else np.array(pose.across_mm)
            centres, scene = measuring_scene(
                self._artefact(pose),
                self._probe,
                self.layout.mount,
                frame=self.layout.frame,
                location_mm=location_mm,
                azimuth_rad=math.radians(pose.azimuth_deg),
                elevation_rad=math.radians(pose.elevation_deg),
                other_bodies=self.layout.neighbours.get(pose.station, ()),
            )
            back = point(-location_mm)
            self._posed_cache[pose] = PosedBodies(
                centres + back,
                [point(centre) for centre in centres + back],
                PrefilteredScene.of(scene.translated(back)),
            )
        return self._posed_cache[pose]

    def sweep(self, before: ArtefactPose, after: ArtefactPose) -> TurnSweep:
        """Return the volume swept by the bodies that turn with the mount between two poses."""
        low, high = (
            tuple(choose(a, b) for a, b in zip(_mount_angles(before), _mount_angles(after), strict=True))
            for choose in (min, max)
        )
        key = (low, high, after.across_mm, after.station)
        if key not in self._sweeps:
            self._sweeps[key] = turn_sweep(
                self.cover(after),
                self.layout.probe,
                self.layout.frame,
                self._stationary_shapes(after),
                (low[0], low[1]),
                (high[0], high[1]),
                clearance_mm=self.turn_clearance_mm,
            )
        return self._sweeps[key]

    def _stationary_shapes(self, pose: ArtefactPose) -> list[Shape]:
        """Return the shapes that do not turn with the mount: its pedestal, the table and all other bodies."""
        scene = self.posed(pose).prefiltered.scene
        artefact = self._artefact(pose)
        turning_names = {"shaft", *map(ball_name, range(artefact.count)), *(rod.name for rod in artefact.rods)}
        return [body.shape for body in scene.obstacles if body.name not in turning_names]


def _mount_angles(pose: ArtefactPose) -> tuple[float, float]:
    return pose.azimuth_deg, pose.elevation_deg
