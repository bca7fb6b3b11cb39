"""Section `[temperatures]` of a scenario: initial temperatures, heating, and the thermal effects."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, NonNegativeFloat

from twin.formats.toml_reading import StrictModel

Coordinates = tuple[float, float, float]
Temperature = Annotated[float, Field(ge=-20.0, le=60.0)]
Hours = Annotated[float, Field(ge=0.0, le=100.0)]


class ThermalSettings(StrictModel):
    """Initial temperatures and their change; without any key nothing warms.

    The ambient rises by `ambient_rise_k` as 1 - exp(-t/τ) with `ambient_time_constant_h` (0: at once, as when the doors
    are opened). Artefact and machine follow it, each with its own lag; None: they do not. In addition both may drift
    linearly, per hour.

    Thermal effects, per kelvin since the start: `growth_um_per_k` moves the tip (spindle and ram grow);
    `scale_um_per_m_k` stretches the scale of each axis about its zero; `bend_um_per_k` bends the column, forwards at
    its top, lagging the machine's thermometer by `bend_time_constant_h`; `artefact_bow_um_per_k` bows the bar at its
    middle per kelvin by which the ambient leads it.

    Thermometers: `artefact_sensors` of them on the artefact; `sensor_offset_k` by name (``artefact``, ``artefact-2``,
    ``machine``, ``ambient``), the noise of each reading, and the lag of the readings.
    """

    artefact_c: Temperature = 20.0
    machine_c: Temperature = 20.0
    ambient_c: Temperature = 20.0
    artefact_k_per_h: float = Field(default=0.0, ge=-20.0, le=20.0)
    machine_k_per_h: float = Field(default=0.0, ge=-20.0, le=20.0)
    ambient_rise_k: float = Field(default=0.0, ge=-20.0, le=20.0)
    ambient_time_constant_h: Hours = 0.0
    artefact_time_constant_h: Hours | None = None
    machine_time_constant_h: Hours | None = None
    growth_um_per_k: Coordinates = (0.0, 0.0, 0.0)
    scale_um_per_m_k: Coordinates = (0.0, 0.0, 0.0)
    bend_um_per_k: float = Field(default=0.0, ge=-100.0, le=100.0)
    bend_time_constant_h: Hours = 0.0
    artefact_bow_um_per_k: float = Field(default=0.0, ge=-100.0, le=100.0)
    artefact_sensors: int = Field(default=1, ge=1, le=6)
    sensor_offset_k: dict[str, float] = Field(default_factory=dict)
    sensor_noise_k: NonNegativeFloat = 0.0
    sensor_lag_s: NonNegativeFloat = 0.0
