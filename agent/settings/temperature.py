"""Section `[temperature]` of the settings file: thermometers, thermal stability limits, and the model of the thermal
drift of the machine."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Self

from pydantic import Field, ValidationInfo, field_validator, model_validator

from twin.formats.toml_reading import StrictModel
from twin.thermal.artefact_temperature import assumed_uncertainty_k
from twin.units import REFERENCE_TEMPERATURE_C

Sensor = Annotated[str, Field(min_length=1, pattern=r"^[A-Za-z0-9_.-]+$")]


def why_no_drift_sensor(name: str, names: Sequence[str], artefact_sensors: Sequence[str]) -> str:
    """Return why the sensor `name`, one of `names`, cannot explain a drift of the machine; empty if it may."""
    if names.count(name) > 1:
        return f"the sensor {name!r} is named twice"
    if name in artefact_sensors:
        return (
            f"the sensor {name!r} is one of temperature.artefact_sensors: the temperature of the artefact does not "
            "explain a drift of the machine"
        )
    return ""


class TemperatureSettings(StrictModel):
    """Temperature settings. Sensors have the names that the thermometer reports; the readings of several sensors on one
    body are averaged.

    `standard_uncertainty_k` is the standard uncertainty of the artefact temperature, common to the whole run. If it is
    not stated, 1 K is assumed, and the report names what this costs.
    `declared_artefact_c` is the artefact temperature that is used if the artefact has no sensor. The run waits while
    the artefact changes faster than `max_rate_k_per_h` or differs by more than `max_departure_k` from 20 °C. While it
    waits, it reads the sensors every `poll_interval_s`; it gives up after `max_wait_minutes`.

    The first ball of each position is measured again at the end of the position. A shift of the ball beyond
    `drift_warning_um` is reported; a shift beyond `procedure.drift_limit_um` ends the run.

    The thermal drift of the machine is fitted if the machine temperature changes by at least `min_change_k`. If the
    machine has no sensor, the change is assumed to be `declared_change_k`. The prior standard deviations per kelvin are
    `scale_um_per_m_k` for the scales of the axes, `bending_um_per_m_k` for bending and tilt of guides, and
    `tip_um_per_k` for the position of the tip. The position of the tip includes the growth of the scales at mid-travel.

    `drift_sensors` are up to four thermometers of the machine whose temperatures `volcal history thermal` compares with
    the drift between nights; if none is named, all that were recorded except those of the artefact are used. Sensors of
    the artefact are refused: by day it is not in the machine, and at night their readings explain its own errors, such
    as a wrong coefficient of expansion, as if the machine had drifted.
    `drift_sensor_uncertainty_k` is the standard uncertainty of their changes from night to night.

    The first `repeat_positions` positions at the first station are measured again at the end of the run if the machine
    temperature has changed by at least `repeat_after_change_k`.
    """

    artefact_sensors: list[Sensor] = Field(default=["artefact"], min_length=1)
    machine_sensors: list[Sensor] = Field(default=["machine"])
    declared_artefact_c: float | None = Field(default=None, ge=-10.0, le=50.0)
    standard_uncertainty_k: float | None = Field(default=None, ge=0.0, le=5.0)
    max_rate_k_per_h: float = Field(default=10.0, gt=0.0, le=100.0)
    max_departure_k: float = Field(default=10.0, gt=0.0, le=30.0)
    poll_interval_s: float = Field(default=60.0, ge=5.0, le=600.0)
    max_wait_minutes: float = Field(default=60.0, ge=0.0, le=1440.0)
    drift_warning_um: float = Field(default=5.0, gt=0.0, le=100.0)
    fit_machine_drift: bool = True
    min_change_k: float = Field(default=0.2, gt=0.0, le=10.0)
    declared_change_k: float = Field(default=0.0, ge=0.0, le=20.0)
    scale_um_per_m_k: float = Field(default=12.0, gt=0.0, le=100.0)
    bending_um_per_m_k: float = Field(default=0.7, gt=0.0, le=100.0)
    tip_um_per_k: float = Field(default=30.0, gt=0.0, le=500.0)
    drift_sensors: list[Sensor] = Field(default=[], max_length=4)
    drift_sensor_uncertainty_k: float = Field(default=0.1, gt=0.0, le=5.0)
    repeat_after_change_k: float = Field(default=0.5, ge=0.0, le=20.0)
    repeat_positions: int = Field(default=3, ge=1, le=20)

    @property
    def artefact_uncertainty_k(self) -> float:
        """Standard uncertainty in K of the artefact temperature; a large one if none is stated."""
        stated = self.standard_uncertainty_k
        return assumed_uncertainty_k(was_read=True) if stated is None else stated

    @field_validator("drift_sensors")
    @classmethod
    def _each_once_and_of_the_machine(cls, names: list[str], known: ValidationInfo) -> list[str]:
        for name in names:
            if reason := why_no_drift_sensor(name, names, known.data.get("artefact_sensors", ())):
                raise ValueError(reason)
        return names

    @model_validator(mode="after")
    def _declared_can_be_used(self) -> Self:
        declared = self.declared_artefact_c
        if declared is None:
            return self
        if not self.standard_uncertainty_k:
            raise ValueError("declared_artefact_c requires standard_uncertainty_k greater than 0")
        if abs(declared - REFERENCE_TEMPERATURE_C) > self.max_departure_k:
            raise ValueError("declared_artefact_c is farther from 20 °C than max_departure_k: no run could start")
        return self
