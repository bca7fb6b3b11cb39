"""Changes of the machine's errors from night to night: seasonal scale errors, a slow random walk, and a collision."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from drivers.errors import ConfigurationError
from simulators.scenario import AgeingSettings, Scenario
from simulators.world.field_changes import CollisionInRun
from simulators.world.noise import generator
from twin.arrays import Array
from twin.machine.error_model import ErrorModel
from twin.machine.kinematic_chain import AXES
from twin.machine.machine_description import MachineDescription
from twin.machine.machine_population import family_from_amplitudes
from twin.machine.true_machine import TrueMachine

# A prime, far larger than the number of nights of any campaign.
_SEED_OFFSET_PER_NIGHT = 1_000_003
"""Seed offset between consecutive nights, so that no two nights share noise."""


def apply_ageing(machine: TrueMachine, description: MachineDescription, ageing: AgeingSettings) -> TrueMachine:
    """Return `machine` with the errors that it has, because of its ageing, at the beginning of the night numbered
    `ageing.night`.

    Raises ConfigurationError if `ageing.collision` names an error that the machine does not have.
    """
    model = machine.model
    if model is None:
        return machine
    change = seasonal_change(model, ageing) + _random_walk_change(model, description, machine.tool_offset, ageing)
    if (
        ageing.collision_night is not None
        and ageing.night >= ageing.collision_night
        and _struck_at_minute(ageing) is None
    ):
        change += collision_change(model, ageing.collision)
    return replace(machine, parameters=machine.parameters + change)


def collision_in_run(machine: TrueMachine, ageing: AgeingSettings) -> CollisionInRun | None:
    """Return the collision during the simulated night, or None if there is none.

    `machine` is the machine at the beginning of the night. Raises ConfigurationError as `apply_ageing` does.
    """
    minute = _struck_at_minute(ageing)
    if machine.model is None or minute is None:
        return None
    after = replace(machine, parameters=machine.parameters + collision_change(machine.model, ageing.collision))
    return CollisionInRun(60.0 * minute, machine, after)


def _struck_at_minute(ageing: AgeingSettings) -> float | None:
    """Return the minute of the simulated night at which the collision happens, or None if none happens during it."""
    return ageing.collision_minute if ageing.night == ageing.collision_night else None


def scenario_of_night(scenario: Scenario, night: int) -> Scenario:
    """Return the scenario for `night`: the same machine and artefact with different noise and a different mount
    placement.
    """
    settings = scenario.settings
    ageing = settings.ageing.model_copy(update={"night": night})
    seed = settings.seed + _SEED_OFFSET_PER_NIGHT * (night - settings.ageing.night)
    return replace(scenario, settings=settings.model_copy(update={"ageing": ageing, "seed": seed}))


def seasonal_change(model: ErrorModel, ageing: AgeingSettings) -> Array:
    """Return the change of the p model parameters since night 0 that seasonal scale errors cause, as an array of shape
    (p,).

    A scale error s over a travel of length L corresponds to the value s L / 2 of the order-1 Legendre coefficient of
    the positioning error of that axis.
    """
    change = np.zeros(model.size)
    for axis, amplitude, phase_deg, (low, high) in zip(
        AXES, ageing.seasonal_um_per_m, ageing.phases_deg, model.ranges_mm, strict=True
    ):
        phase, turned = math.radians(phase_deg), 2.0 * math.pi * ageing.night / ageing.season_nights
        # minus the value of night 0, for which the scenario states the errors
        scale = 1e-6 * amplitude * (math.sin(turned + phase) - math.sin(phase))
        if scale:
            change[_place(model, f"E{axis}{axis}[1]")] = 0.5 * scale * (high - low)
    return change


def collision_change(model: ErrorModel, jumps: Mapping[str, float]) -> Array:
    """Return the change of the p model parameters that one collision causes, as an array of shape (p,).

    `jumps` maps the name of each changed error to its change in µm or µrad. If the name of an error motion contains no
    Legendre order, the Legendre coefficient of its lowest order changes.
    """
    change = np.zeros(model.size)
    for name, jump in jumps.items():
        place = _place(model, name)
        change[place] += jump * (1e-3 if model.parameters[place].unit == "mm" else 1e-6)
    return change


def _random_walk_change(
    model: ErrorModel, description: MachineDescription, tool_offset: Array, ageing: AgeingSettings
) -> Array:
    """Return the change (p,) of the model parameters by a random walk, the sum of independent nightly steps.

    The step of a night depends only on the seed and the night.
    """
    if not (ageing.walk_um and ageing.night):
        return np.zeros(model.size)
    # Takes a third of the start of a simulator, and hardly any scenario has a random walk.
    from twin.identification import process_noise  # noqa: PLC0415

    family = family_from_amplitudes(model, description.amplitudes)
    step = process_noise(family, 1e-3 * ageing.walk_um, tool_offset)
    nights = range(1, ageing.night + 1)
    # One generator for each night: the steps of earlier nights are the same, whichever night is simulated.
    drawn = [generator(ageing.seed, f"walk {night}").standard_normal(model.size) for night in nights]
    return np.asarray(step * np.sum(drawn, axis=0))


def _place(model: ErrorModel, name: str) -> int:
    for place, parameter in enumerate(model.parameters):
        if name in (parameter.name, parameter.error):
            return place
    raise ConfigurationError(
        f"the machine has no error {name!r} that could jump",
        key="ageing.collision",
        hint="write ISO 230-1 names such as B0Z, EAZ or EYX, or one coefficient such as EAZ[2]",
    )
