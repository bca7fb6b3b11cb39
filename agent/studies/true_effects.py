"""Effects of the true machines in a study that are stated by name and size, such as `backlash=5um`.

The names are those of the simulator's scenario. Each effect makes the true machines and their measurement richer than
the model that is identified.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from drivers.errors import ConfigurationError
from twin.arrays import Array
from twin.uncertainty.measurement_effects import LobingEffect, LostMotionEffect, MeasurementEffect, WarmingEffect
from twin.uncertainty.truth_assumptions import TruthAssumptions
from twin.units import MM_PER_UM

_STATED = re.compile(r"([a-z]+)=(\d{1,9}(?:\.\d{1,9})?)(um|µm|\u03bcm|K|C)", re.ASCII)
_UNITS = {"um": "µm", "µm": "µm", "\u03bcm": "µm", "K": "K", "C": "°C"}

WITH_EFFECTS = (
    "ball-count", "claims", "design", "misalignment", "monte-carlo", "strategy", "trajectory", "uncertainty",
    "valuation",
)  # fmt: skip
"""Names of the studies that simulate a measurement on machines drawn as the machine file says."""

WITH_TRUE_MACHINE = (*(name for name in WITH_EFFECTS if name != "claims"), "volumetric-error")
"""Names of the studies whose true machines can be those of another machine file."""

Directions = Sequence[Array]
"""For each tool, the directions (k, 3) of the touches of a ball, as unit vectors towards the ball."""


@dataclass(frozen=True)
class EffectKind:
    """Kind of effect: its unit as it is written on the command line, its largest size, and what it does in words."""

    unit: str
    largest: float
    meaning: str


EFFECTS = {
    "backlash": EffectKind("um", 1000.0, "lost motion of each axis, rms over machines"),
    "heat": EffectKind("K", 50.0, "machine warms until the last ball: scales and tip grow, rms"),
    "gradient": EffectKind("K", 50.0, "temperature difference in the machine until the last ball: it bends, rms"),
    "lobing": EffectKind("um", 1000.0, "pretravel with three lobes, rms amplitude"),
    "drift": EffectKind("um", 1000.0, "drift from first to last ball of each position, rms"),
    "thermometer": EffectKind("K", 50.0, "error of the thermometer of the artefact, rms"),
    "artefact": EffectKind("C", 50.0, "true temperature of the artefact"),
}
"""Effects by name."""


@dataclass(frozen=True)
class StatedEffect:
    """Effect with the `name` in EFFECTS and its size in the unit of its kind."""

    name: str
    size: float

    def __str__(self) -> str:
        return f"{self.name}={self.size:g}{EFFECTS[self.name].unit}"


def parse_effect(text: str) -> StatedEffect:
    """Return the effect stated by `text`, such as `backlash=5um`.

    Raises ConfigurationError, which names the effects with their units, for anything else.
    """
    found = _STATED.fullmatch(text.strip())
    offered = ", ".join(f"{name}=…{kind.unit}" for name, kind in EFFECTS.items())
    if found is None:
        raise ConfigurationError(
            f"{text[:80]!r} states no effect with its size and unit", hint=f"write one of {offered}", key="--with"
        )
    name, size, unit = found[1], float(found[2]), found[3]
    kind = EFFECTS.get(name)
    if kind is None:
        raise ConfigurationError(f"there is no effect '{name}'", hint=f"choose one of {offered}", key="--with")
    if _UNITS[unit] != _UNITS[kind.unit]:
        raise ConfigurationError(
            f"the size of '{name}' is in {_UNITS[kind.unit]}, not in {_UNITS[unit]}",
            hint=f"write {name}={size:g}{kind.unit}",
            key="--with",
        )
    if size > kind.largest:
        raise ConfigurationError(
            f"{size:g} {_UNITS[unit]} of '{name}' is more than {kind.largest:g} {_UNITS[unit]}",
            hint="check the unit",
            key="--with",
        )
    return StatedEffect(name, size)


def parse_effects(texts: Sequence[str]) -> tuple[StatedEffect, ...]:
    """Return the effects stated by `texts`. Raises ConfigurationError also if an effect is stated twice."""
    found = tuple(parse_effect(text) for text in texts)
    names = [one.name for one in found]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise ConfigurationError(f"the effect '{twice}' is stated twice", hint="state it once", key="--with")
    return found


def check_study(study: str, *, effects: bool, true_machine: bool) -> None:
    """Raise ConfigurationError if the study called `study` cannot take stated effects, or the machine file of the true
    machines, although they are given."""
    for given, key, takers in (
        (effects, "--with", WITH_EFFECTS),
        (true_machine, "--true-machine", WITH_TRUE_MACHINE),
    ):
        if given and study not in takers:
            raise ConfigurationError(
                f"the study '{study}' does not take {key}: it chooses its true machines itself or measures nothing",
                hint=f"omit {key}, or choose one of {', '.join(takers)}",
                key=key,
            )


def with_effects(
    assumptions: TruthAssumptions, effects: Sequence[StatedEffect], directions: Directions
) -> TruthAssumptions:
    """Return the assumptions about true machines with the stated effects added."""
    sizes = {one.name: one.size for one in effects}
    makers: dict[str, Callable[[float], MeasurementEffect]] = {
        "backlash": lambda um: LostMotionEffect(MM_PER_UM * um, directions),
        "heat": lambda kelvin: WarmingEffect(kelvin, bends=False),
        "gradient": lambda kelvin: WarmingEffect(kelvin, bends=True),
        "lobing": lambda um: LobingEffect(MM_PER_UM * um, directions),
    }
    added = tuple(make(sizes[name]) for name, make in makers.items() if sizes.get(name, 0.0) > 0.0)
    return replace(
        assumptions,
        drift_mm=MM_PER_UM * sizes["drift"] if "drift" in sizes else assumptions.drift_mm,
        thermometer_uncertainty_k=sizes.get("thermometer", assumptions.thermometer_uncertainty_k),
        artefact_temperature_c=sizes.get("artefact", assumptions.artefact_temperature_c),
        effects=(*assumptions.effects, *added),
    )
