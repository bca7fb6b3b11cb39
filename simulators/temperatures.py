"""Section `[temperatures]` of a scenario: initial temperatures, their change, thermal effects and thermometers."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, NonNegativeFloat, field_validator

from twin.formats.toml_reading import StrictModel

Coordinates = tuple[float, float, float]
Temperature = Annotated[float, Field(ge=-20.0, le=60.0)]
Hours = Annotated[float, Field(ge=0.0, le=100.0)]
BodyName = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_-]*$", max_length=40)]
_OWN_NAMES = ("artefact", "machine", "ambient")


class ThermalSettings(StrictModel):
    """Initial temperatures and their change, thermal effects, and thermometers. By default all temperatures are
    constant.

    The ambient temperature rises by `ambient_rise_k` in proportion to 1 - exp(-t/τ). Here t is the time since the
    start, and τ is `ambient_time_constant_h`. If τ is 0, the ambient temperature rises at once, as when the doors are
    opened. Artefact and machine each follow the ambient temperature with a time constant, unless this time constant is
    None. In addition, the temperatures of artefact and machine may drift linearly with time, in K per hour.

    The thermal effects are proportional to the temperature change since the start. `growth_um_per_k` moves the tip,
    because spindle and ram grow. `scale_um_per_m_k` stretches the measuring scale of each axis about its zero.
    `bend_um_per_k` displaces the top of the column forwards; this bending lags behind the machine's thermometer with
    the time constant `bend_time_constant_h`. `artefact_bow_um_per_k` displaces the middle of the artefact, a bar, per
    kelvin by which the ambient temperature has risen more than the temperature of the bar.

    `artefact_sensors` is the number of thermometers on the artefact. `body_time_constants_h` are further thermometers,
    at bodies of the machine such as ``column``, ``ram`` and ``bed``, with the time constant with which each of them
    follows the ambient temperature; they start at `machine_c` and drift linearly like the machine. `sensor_offset_k`
    gives the offset of each thermometer by its name (``artefact``, ``artefact-2``, ``machine``, ``ambient``,
    ``column``). `sensor_noise_k` is the noise of each reading, and `sensor_lag_s` is the lag of the readings.
    `sensor_stuck_after_h` gives the time by the name of a thermometer from which it repeats its last reading.
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
    body_time_constants_h: dict[BodyName, Hours] = Field(default_factory=dict, max_length=4)
    sensor_stuck_after_h: dict[str, NonNegativeFloat] = Field(default_factory=dict)
    sensor_offset_k: dict[str, float] = Field(default_factory=dict)
    sensor_noise_k: NonNegativeFloat = 0.0
    sensor_lag_s: NonNegativeFloat = 0.0

    @field_validator("body_time_constants_h")
    @classmethod
    def _bodies_have_names_of_their_own(cls, given: dict[str, float]) -> dict[str, float]:
        for name in given:
            if name.split("-")[0] in _OWN_NAMES:
                raise ValueError(f"{name} is a thermometer that every scenario has")
        return given
