"""Section `[temperatures]` of a scenario: initial temperatures, heating, and the thermal effects."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, NonNegativeFloat

from twin.formats.toml_reading import StrictModel

Coordinates = tuple[float, float, float]
Temperature = Annotated[float, Field(ge=-20.0, le=60.0)]
Hours = Annotated[float, Field(ge=0.0, le=100.0)]


class ThermalSettings(StrictModel):
    """Initial temperatures and their change. By default all temperatures are constant.

    The ambient temperature rises by `ambient_rise_k` as 1 - exp(-t/τ), where τ is `ambient_time_constant_h`. If τ is
    0, it rises at once, as when the doors are opened. Artefact and machine follow it, each with its own time constant;
    one whose time constant is None does not follow. In addition both may drift linearly with time, in K per hour.

        Thermal effects, per kelvin since the start: `growth_um_per_k` moves the tip (spindle and ram grow);
    `scale_um_per_m_k` stretches the scale of each axis about its zero; `bend_um_per_k` displaces the top of the column
    forwards, with an additional lag `bend_time_constant_h` behind the machine's thermometer; `artefact_bow_um_per_k`
    displaces the middle of the bar, per kelvin by which the ambient has warmed more than the bar.

        Thermometers: `artefact_sensors` is their number on the artefact, `sensor_offset_k` their offsets by name
    (``artefact``, ``artefact-2``, ``machine``, ``ambient``), `sensor_noise_k` the noise of each reading, and
    `sensor_lag_s` the lag of the readings.
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
