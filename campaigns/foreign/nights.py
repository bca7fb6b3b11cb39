"""Nights of a foreign machine whose changes are not a random walk of the program's model."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from campaigns.foreign.artefact import S3, STATIONS_MM, ForeignBar, measure, tilted_bar
from campaigns.foreign.machine import GRID, TOOL, ForeignMachine, Motion, Waves, foreign_machine
from campaigns.foreign.score import family_of, true_error_um
from twin.artefact.observations import Observations
from twin.identification import Estimate, Options, identify, process_noise
from twin.identification.identify import accepted_rows
from twin.identification.predicted import expected_vce, field_forms
from twin.monitoring.night_fit import NightFit, compare_with_nights_before
from twin.uncertainty.volumetric_limits import limits_of_form

NIGHTS, STEP_NIGHT, STATED_UM, SEED = 60, 20, 0.5, 7
FAMILY = family_of(5)
_STEP_MM, _SEASON_NIGHTS, _POSITIONS, _WAVES = 12e-3, 45.0, 5, 9
_SLOPES_MM, _TURNS_RAD = np.array([30e-3, 18e-3, 21e-3]), 6e-6
_SQUARENESS = ("A0Z", "B0Z", "C0Y")
_SQUARENESS_WALK_RAD, _BENDING_WALK_UM = 0.3e-6, 0.2

Change = Callable[[ForeignMachine, int, np.random.Generator], ForeignMachine]
"""Function that returns the machine of a night from the machine of the night before and the number of the night."""


def straightness_steps(machine: ForeignMachine, night: int, rng: np.random.Generator) -> ForeignMachine:
    """Let all error motions walk a little, and bend the rail of X sideways by 12 µm in the step night."""
    walked = _walked(machine, 0.2, rng, (0, 1, 2))
    if night != STEP_NIGHT:
        return walked
    x, y, z = walked.motions
    bent = np.zeros((6, _WAVES))
    bent[1, 1] = _STEP_MM  # straightness of X along Y, one wave over the travel
    return replace(walked, motions=(_changed(x, bent, np.zeros(6)), y, z))


def walk(machine: ForeignMachine, night: int, rng: np.random.Generator) -> ForeignMachine:
    """Let the error motions of all axes walk, by about the 0.5 µm a night that is stated."""
    return _walked(machine, 0.22, rng, (0, 1, 2))


def still(machine: ForeignMachine, night: int, rng: np.random.Generator) -> ForeignMachine:
    """Leave the machine as it is."""
    return machine


def drift(error: str, per_night: float, first_night: int = 1) -> Change:
    """Return the change by which one error grows by a constant amount per night from `first_night` on.

    `error` is named as in ISO 230-1. An error motion turns into a straight line over the travel, whose ends differ by
    `per_night` more every night; a squareness changes by `per_night`. The amount is in mm or rad.
    """

    def change(machine: ForeignMachine, night: int, rng: np.random.Generator) -> ForeignMachine:
        return sloped_machine(machine, error, per_night) if night >= first_night else machine

    return change


def step(error: str, size: float, at: int = STEP_NIGHT) -> Change:
    """Return the change by which one error grows by `size`, in mm or rad, in the night `at`: an error motion by one
    wave over the travel, a squareness by an angle."""

    def change(machine: ForeignMachine, night: int, rng: np.random.Generator) -> ForeignMachine:
        if night != at:
            return machine
        if error in _SQUARENESS:
            return sloped_machine(machine, error, size)
        axis, component = _place_of(error)
        bent = np.zeros((6, _WAVES))
        bent[component, 1] = size
        return _with_change(machine, axis, bent, np.zeros(6))

    return change


def walk_of_everything(machine: ForeignMachine, night: int, rng: np.random.Generator) -> ForeignMachine:
    """Let error motions, squareness and the deflection of ram and column walk, by about 0.5 µm a night."""
    walked = walk(machine, night, rng)
    squareness = walked.squareness + rng.normal(0.0, _SQUARENESS_WALK_RAD, 3)
    bending = walked.bending.copy()
    bending[[0, 2, 3, 4, 5]] += rng.normal(0.0, _BENDING_WALK_UM, 5)  # the second is an exponent
    return replace(walked, squareness=squareness, bending=bending)


def season(machine: ForeignMachine, night: int, rng: np.random.Generator) -> ForeignMachine:
    """Let scales and slopes of the angles follow a season, which changes the machine by 1 to 2 µm a night."""
    phase = 2.0 * math.pi / _SEASON_NIGHTS
    motions = []
    for axis, motion in enumerate(machine.motions):
        change = math.sin(phase * night + axis) - math.sin(phase * (night - 1) + axis)
        slope = np.zeros(6)
        slope[axis] = _SLOPES_MM[axis] * change
        slope[3:] = _TURNS_RAD * change * np.array([1.0, -0.6, 0.8])
        motions.append(_changed(motion, np.zeros((6, _WAVES)), slope))
    x, y, z = motions
    return replace(machine, motions=(x, y, z))


def one_axis_only(machine: ForeignMachine, night: int, rng: np.random.Generator) -> ForeignMachine:
    """Let the error motions of X alone walk, by 1 µm a night."""
    return _walked(machine, 1.0, rng, (0,))


def _walked(machine: ForeignMachine, size: float, rng: np.random.Generator, axes: tuple[int, ...]) -> ForeignMachine:
    unit = size * np.array([1e-3] * 3 + [0.8e-6] * 3)[:, None]
    motions = list(machine.motions)
    for axis in axes:
        steps = rng.normal(size=(6, _WAVES)) / np.arange(1, _WAVES + 1) ** 1.5
        motions[axis] = _changed(motions[axis], unit * steps, np.zeros(6))
    x, y, z = motions
    return replace(machine, motions=(x, y, z))


def _place_of(error: str) -> tuple[int, int]:
    """Return the axis of an error motion, and its place among displacements along and rotations about X, Y and Z."""
    return "XYZ".index(error[2]), "XYZABC".index(error[1])


def sloped_machine(machine: ForeignMachine, error: str, amount: float) -> ForeignMachine:
    """Return the machine after one error has changed by `amount` in mm or rad: a squareness, or an error motion that
    turns into a straight line over the travel."""
    if error in _SQUARENESS:
        return replace(machine, squareness=machine.squareness + amount * np.eye(3)[_SQUARENESS.index(error)])
    axis, component = _place_of(error)
    return _with_change(machine, axis, np.zeros((6, _WAVES)), amount * np.eye(6)[component])


def _with_change(machine: ForeignMachine, axis: int, amplitude: np.ndarray, slope: np.ndarray) -> ForeignMachine:
    motions = list(machine.motions)
    motions[axis] = _changed(motions[axis], amplitude, slope)
    x, y, z = motions
    return replace(machine, motions=(x, y, z))


@dataclass(frozen=True)
class _Drifted:
    """Error motion of an axis at the start, and its change since then."""

    start: Motion
    change: Waves

    def at(self, share: np.ndarray) -> np.ndarray:
        found: np.ndarray = self.start.at(share) + self.change.at(share)
        return found


def _changed(motion: Motion, amplitude: np.ndarray, slope: np.ndarray) -> Motion:
    """Return the error motion after a change by waves of these amplitudes (6, k) and by slopes (6,)."""
    if not isinstance(motion, _Drifted):
        still = np.zeros((6, _WAVES))
        wave = np.tile(np.arange(1.0, _WAVES + 1.0), (6, 1))
        motion = _Drifted(motion, Waves(still, wave, 0.7 * wave + np.arange(6.0)[:, None], np.zeros(6)))
    before = motion.change
    return replace(motion, change=replace(before, amplitude=before.amplitude + amplitude, slope=before.slope + slope))


@dataclass(frozen=True)
class NightScore:
    """One night: the machine of this night, its estimate, its comparison with the nights before, and the true and the
    predicted error in µm that the estimate leaves after the best rigid motion is removed. `limits_um` are the stated
    95 % limits of that error."""

    number: int
    machine: ForeignMachine
    estimate: Estimate
    fit: NightFit
    true_um: float
    predicted_um: float
    limits_um: tuple[float, float]

    @property
    def ratio(self) -> float:
        return self.true_um / self.predicted_um

    @property
    def held(self) -> bool:
        """True if the stated limits contain the true error."""
        return self.limits_um[0] <= self.true_um <= self.limits_um[1]


@dataclass(frozen=True)
class MeasuredNight:
    """Machine of a night and what was measured on it."""

    machine: ForeignMachine
    bar: ForeignBar
    seen: Observations


def measured_nights(change: Change, count: int, seed: int = SEED) -> Iterator[MeasuredNight]:
    """Yield a full night at all stations, and after it `count` nights with five positions at one station."""
    rng, drift = np.random.default_rng(seed), np.random.default_rng(seed + 50)
    machine, bar = foreign_machine(rng), tilted_bar(rng)
    yield MeasuredNight(machine, bar, measure(machine, bar, S3, rng).seen)
    for night in range(1, count + 1):
        machine = change(machine, night, drift)
        orientations = [S3[(night + number) % len(S3)] for number in range(_POSITIONS)]
        stations = [STATIONS_MM[night % len(STATIONS_MM)]]
        yield MeasuredNight(machine, bar, measure(machine, bar, orientations, rng, stations=stations).seen)


def fused_nights(
    change: Change, count: int = NIGHTS, stated_um: float = STATED_UM, seed: int = SEED
) -> list[NightScore]:
    """Fuse each night with those before, as the program does, and compare every estimate with the truth."""
    nights = measured_nights(change, count, seed)
    first = next(nights)
    estimate = identify(FAMILY.model, first.seen, first.bar.artefact, FAMILY)
    noise = process_noise(FAMILY, 1e-3 * stated_um, TOOL)
    scores = []
    for number, night in enumerate(nights, start=1):
        artefact, seen = night.bar.artefact, night.seen
        accepted = seen.select(accepted_rows(FAMILY, seen, artefact, Options()).mask)
        fit = compare_with_nights_before(FAMILY, accepted, artefact, estimate.carried_over(), noise)
        estimate = identify(FAMILY.model, seen, artefact, FAMILY, Options(carried_over=fit.prior))
        true_um, forms = true_error_um(night.machine, estimate), field_forms(estimate, GRID, TOOL)
        predicted_um, limits_um = expected_vce(estimate, forms).aligned_um, limits_of_form(estimate, forms[1]).vce_um
        scores.append(NightScore(number, night.machine, estimate, fit, true_um, predicted_um, limits_um))
    return scores
