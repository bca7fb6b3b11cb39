"""Variants of an artefact with its mount: bar of balls, rotation centre of the mount, and stations."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property
from pathlib import Path

import numpy as np

from agent.files import translated
from agent.planning.design.artefact_costs import CalibrationCosts, Equipment
from agent.planning.design.bar_variants import Bar
from agent.planning.job import Job
from agent.planning.job_preparation import prepare_job
from agent.settings.schema import Settings
from drivers.errors import ConfigurationError, InputError
from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.ball_spacing import BallSpacing, spaced_balls, stated_places
from twin.artefact.certificate import with_length_uncertainty
from twin.artefact.mount_geometry import MountGeometry
from twin.errors import DataError
from twin.units import MM_PER_UM

_ANY_SET = "S1+S2+S3"  # the positions are designed; a position file could name stations that a variant has not
_Z = 2


class CentrePlace(StrEnum):
    """Place of the rotation centre of the mount relative to the bar.

    - BESIDE: a horizontal shaft carries the bar at a distance beside the azimuth axis.
    - ABOVE: a shaft carries the bar at a distance above the rotation centre, if the elevation is 0.
    - MIDDLE: the rotation centre is the middle of the bar. A fork holds it, and the pedestal ends at a distance below.
    """

    BESIDE = "beside"
    ABOVE = "above"
    MIDDLE = "middle"


@dataclass(frozen=True)
class RotationCentre:
    """Rotation centre of the mount. `distance_mm` is the length of the shaft between rotation centre and bar; for
    MIDDLE it is the distance from the rotation centre down to the end of the pedestal's axis."""

    place: CentrePlace
    distance_mm: float

    def __str__(self) -> str:
        return f"{self.place}:{self.distance_mm:g}"

    @classmethod
    def of(cls, mount: MountGeometry) -> RotationCentre:
        """Return the rotation centre of `mount`. Raises ConfigurationError if its shaft is oblique."""
        if mount.shaft_mm == 0.0:
            return cls(CentrePlace.MIDDLE, max(0.0, -mount.head_mm))
        x, y, z = (abs(one) for one in mount.shaft_direction)
        places = {CentrePlace.BESIDE: y, CentrePlace.ABOVE: z}
        place = max(places, key=lambda one: places[one])
        if places[place] < 0.999 * math.hypot(x, y, z):
            raise ConfigurationError(
                "the shaft of the mount is neither beside the azimuth axis nor above it",
                key="mount.shaft_direction",
                hint="the design of an artefact knows shafts along Y or Z of the artefact frame",
            )
        return cls(place, mount.shaft_mm)

    @property
    def shaft_mm(self) -> float:
        return 0.0 if self.place is CentrePlace.MIDDLE else self.distance_mm

    def geometry(self, present: MountGeometry) -> MountGeometry:
        """Return the geometry of a mount with this rotation centre. All else is as with the mount `present`."""
        if self == RotationCentre.of(present):
            return present
        if self.place is CentrePlace.MIDDLE:
            return replace(present, shaft_mm=0.0, head_mm=-self.distance_mm)
        head_mm = max(present.head_mm, 0.0)
        present_place = RotationCentre.of(present).place
        along = {CentrePlace.BESIDE: (0.0, -1.0, 0.0), CentrePlace.ABOVE: (0.0, 0.0, present.up)}[self.place]
        direction = present.shaft_direction if present_place is self.place else along
        return replace(present, shaft_mm=self.distance_mm, shaft_direction=direction, head_mm=head_mm)


def parse_centre(text: str) -> RotationCentre:
    """Return the rotation centre written as `beside:120`. Raises ValueError if `text` is none."""
    place, _, distance = text.strip().partition(":")
    centre = RotationCentre(CentrePlace(place), float(distance))
    if not 0.0 < centre.distance_mm < math.inf:
        raise ValueError(text)
    return centre


@dataclass(frozen=True)
class ArtefactVariant:
    """Artefact with its mount.

    The bar has the length `length_mm` between its end balls, `balls` balls with the spacing `spacing` or, if
    `stated_mm` is not empty, at these distances in mm from the first ball, and holders that are tilted by `tilt_deg`.
    The rotation centre `centre` is at `across_mm` along the horizontal machine axis across the stations and at
    `height_mm` along Z, both in the workpiece frame. `stations` is the number of stations.
    """

    length_mm: float
    balls: int
    spacing: BallSpacing
    tilt_deg: float
    centre: RotationCentre
    across_mm: float
    height_mm: float
    stations: int
    stated_mm: tuple[float, ...] = ()

    @property
    def along_mm(self) -> Array:
        """Places (balls,) in mm of the balls along the bar, measured from its middle. Raises DataError if there are
        none."""
        if self.stated_mm:
            return stated_places(self.stated_mm)
        return spaced_balls(self.balls, self.length_mm, self.spacing)

    @property
    def spacing_text(self) -> str:
        return "stated" if self.stated_mm else str(self.spacing)


@dataclass(frozen=True, eq=False)
class PresentEquipment:
    """Artefact and mount of the job `job`, from which variants are derived. `base` is the folder to which paths of the
    settings are relative, and `calibration` states the uncertainty of the certificate that a variant would get."""

    job: Job
    base: Path
    calibration: CalibrationCosts

    def __post_init__(self) -> None:
        if self.job.rules.placement is not None:
            raise InputError(
                "the artefact is placed by hand, so there is no mount to design",
                hint="`volcal design` finds positions for it",
            )
        if self.job.layout.own_artefacts or self.job.rules.change.own_mounts:
            raise InputError(
                "each station has a mount of its own; the design knows one mount that is carried",
                hint="name one mount in roles.mount and remove stations.artefacts",
            )

    @cached_property
    def bar(self) -> Bar:
        """Bar of the settings. Raises ConfigurationError if the artefact is none."""
        with translated(ConfigurationError, file=str(self.job.settings.artefact)):
            return Bar.of(self.job.artefact)

    @cached_property
    def variant(self) -> ArtefactVariant:
        """Variant with the properties of the present artefact and mount."""
        first, bar = self.job.layout.location(min(self.job.layout.locations_mm)), self.bar
        return ArtefactVariant(
            length_mm=round(bar.length_mm, 0),
            balls=self.job.artefact.count,
            spacing=bar.spacing or BallSpacing.EVEN,
            tilt_deg=round(bar.tilt_deg, 0),
            centre=RotationCentre.of(self.job.settings.mount),
            across_mm=float(first[self._across]),
            height_mm=float(first[_Z]),
            stations=len(self.job.layout.locations_mm),
            stated_mm=() if bar.spacing else tuple((bar.along_mm - bar.along_mm[0]).round(1).tolist()),
        )

    def equipment(self, variant: ArtefactVariant) -> Equipment:
        """Return the quantities that determine the purchase of `variant`."""
        mount = self.job.settings.mount
        return Equipment(
            length_mm=variant.length_mm,
            balls=variant.balls,
            shaft_mm=variant.centre.shaft_mm,
            pedestal_mm=abs(variant.height_mm - mount.table_z_mm),
            fork=variant.centre.place is CentrePlace.MIDDLE,
            stations=variant.stations,
        )

    def artefact(self, variant: ArtefactVariant) -> Artefact:
        """Return the nominal bar of `variant` with the uncertainty that its certificate would state. Raises DataError
        if it cannot be made."""
        bar, stated = self.bar.with_(tilt_deg=variant.tilt_deg, along_mm=variant.along_mm), self.calibration
        alone = np.eye(bar.balls.size) * (stated.standard_uncertainty_um * MM_PER_UM) ** 2
        return replace(
            bar,
            name=f"bar {variant.length_mm:g}, {variant.balls} balls, {variant.spacing_text}, {variant.tilt_deg:g}°",
            covariance=with_length_uncertainty(bar.balls, alone, stated.length_standard_uncertainty_ppm),
        )

    def check_places(self, stated_mm: tuple[float, ...], tilts_deg: Sequence[float]) -> None:
        """Raise DataError if a bar with balls at the distances `stated_mm` from the first one cannot be made with any
        of the tilts of its holders, because its balls overlap."""
        refusals: list[str] = []
        for tilt_deg in tilts_deg:
            try:
                self.bar.with_(tilt_deg=tilt_deg, along_mm=stated_places(stated_mm))
            except DataError as error:
                refusals.append(error.message)
            else:
                return
        raise DataError(
            refusals[-1],
            hint=f"the balls have a diameter of {self.job.artefact.ball_diameter_mm:g} mm; state places that are "
            "further apart",
        )

    def places_mm(self, variant: ArtefactVariant) -> Array:
        """Return the places (stations, 3) in mm of the mount, evenly spaced along the axis of the stations.

        The outer ones are as far from the ends of the travel, as a share of the length of the bar, as at present.
        With the present number of stations and length, the places along the axis are those of the settings.
        """
        layout, present = self.job.layout, self.variant
        known = np.array([layout.location(number) for number in sorted(layout.locations_mm)])
        along = layout.station_axis
        if (variant.stations, variant.length_mm) == (present.stations, present.length_mm):
            # places that differ across the stations keep their differences
            moved = known.copy()
            moved[:, self._across] += variant.across_mm - present.across_mm
            moved[:, _Z] += variant.height_mm - present.height_mm
            return np.asarray(moved)
        low, high = self.job.machine.limits[along]
        inset = min(known[:, along].min() - low, high - known[:, along].max()) * variant.length_mm / present.length_mm
        inset = min(max(inset, 0.0), 0.5 * (high - low))
        places = np.empty((variant.stations, 3))
        places[:, self._across], places[:, _Z] = variant.across_mm, variant.height_mm
        places[:, along] = (
            np.linspace(low + inset, high - inset, variant.stations).round()
            if variant.stations > 1
            else round(0.5 * (low + high))
        )
        return places

    def settings(self, variant: ArtefactVariant) -> Settings:
        """Return the settings with the mount and the stations of `variant`."""
        settings, places = self.job.settings, self.places_mm(variant).tolist()
        verified = settings.verification.stations
        ends = sorted({1, variant.stations}) if verified and variant.stations != self.variant.stations else verified
        stations = settings.stations.model_copy(update={"places_mm": [tuple(place) for place in places]})
        if variant.stations != self.variant.stations:
            stations = stations.model_copy(update={"standing_at": None})
        datum = settings.qualification.ball
        if datum is not None and datum >= variant.balls:
            datum = None
        return settings.model_copy(
            update={
                "qualification": settings.qualification.model_copy(update={"ball": datum}),
                "mount": variant.centre.geometry(settings.mount),
                "stations": stations,
                "procedure": settings.procedure.model_copy(update={"position_set": _ANY_SET, "stations": None}),
                "verification": settings.verification.model_copy(update={"stations": ends}),
            }
        )

    def job_of(self, variant: ArtefactVariant) -> Job:
        """Return the job that measures `variant` on the machine. Raises ConfigurationError if it cannot be measured:
        no room for the mount, no ball within reach, or a bar that cannot be made."""
        with translated(ConfigurationError):
            made = prepare_job(self.settings(variant), self.base, self.artefact(variant))
        return replace(made, latencies_from=self.job.latencies_from, stated_timing=self.job.stated_timing)

    @property
    def _across(self) -> int:
        return next(axis for axis in range(_Z) if axis != self.job.layout.station_axis)
