"""The section `[temperature]`: thermometers, when to wait, and what a machine that warms during a run may do."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from twin.artefact.artefact import REFERENCE_TEMPERATURE_C
from twin.formats.toml_reading import Strict

Sensor = Annotated[str, Field(min_length=1, pattern=r"^[A-Za-z0-9_.-]+$")]


class TemperatureSettings(Strict):
    """Names are those that the thermometer tells; several on one body are averaged.

    `standard_uncertainty_k`: of the artefact's temperature, common to the whole run. `declared_artefact_c`: where no
    thermometer is on the artefact. The run waits where the artefact changes by more than `largest_rate_k_per_h` or is
    farther from 20 °C than `largest_departure_k`, looks every `look_every_s` and gives up after `deadline_minutes`.
    `drift_event_um`: of the first ball of a position found again, beyond which it is told; `procedure.drift_limit_um`
    ends the run.

    The machine's drift is fitted where its thermometers change by `smallest_change_k` or more (`declared_change_k`
    where there is none): per kelvin, how much a scale may change, how much a guide bends and tilts, and by how much the
    tip moves, the growth of the scales at the middle of the travel included. The first `close_positions` are measured
    again at the end where the machine has changed by `close_run_k`.
    """

    artefact_sensors: list[Sensor] = Field(default=["artefact"], min_length=1)
    machine_sensors: list[Sensor] = Field(default=["machine"])
    declared_artefact_c: float | None = Field(default=None, ge=-10.0, le=50.0)
    standard_uncertainty_k: float = Field(default=0.0, ge=0.0, le=5.0)
    largest_rate_k_per_h: float = Field(default=10.0, gt=0.0, le=100.0)
    largest_departure_k: float = Field(default=10.0, gt=0.0, le=30.0)
    look_every_s: float = Field(default=60.0, ge=5.0, le=600.0)
    deadline_minutes: float = Field(default=60.0, ge=0.0, le=1440.0)
    drift_event_um: float = Field(default=5.0, gt=0.0, le=100.0)
    fit_machine_drift: bool = True
    smallest_change_k: float = Field(default=0.2, gt=0.0, le=10.0)
    declared_change_k: float = Field(default=0.0, ge=0.0, le=20.0)
    scale_um_per_m_k: float = Field(default=12.0, gt=0.0, le=100.0)
    bending_um_per_m_k: float = Field(default=0.7, gt=0.0, le=100.0)
    tip_um_per_k: float = Field(default=30.0, gt=0.0, le=500.0)
    close_run_k: float = Field(default=0.5, ge=0.0, le=20.0)
    close_positions: int = Field(default=3, ge=1, le=20)

    @model_validator(mode="after")
    def _declared_can_be_used(self) -> Self:
        declared = self.declared_artefact_c
        if declared is None:
            return self
        if self.standard_uncertainty_k == 0.0:
            raise ValueError("declared_artefact_c needs its standard_uncertainty_k: nobody knows a temperature exactly")
        if abs(declared - REFERENCE_TEMPERATURE_C) > self.largest_departure_k:
            raise ValueError("declared_artefact_c is farther from 20 °C than largest_departure_k: no run would begin")
        return self
