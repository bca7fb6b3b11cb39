"""Temperatures of the machine now: read from its thermometer, or told by the service that owns the machine."""

from __future__ import annotations

from pathlib import Path
from typing import TypeGuard

from agent.errors import Busy
from agent.runs.offline.thermometer_reading import read_thermometer
from agent.service.client import Client
from agent.settings.schema import Settings
from drivers.errors import VolcalError
from twin.monitoring.sensor_screening import plausible_readings

LONGEST_AGE_S = 900.0
"""Age in s of a reading of the service beyond which it is none of now: the thermometer no longer answers."""


def temperatures_now(settings: Settings, base: Path) -> tuple[dict[str, float], float]:
    """Return the readings of the thermometer in °C by sensor, and their age in s. `base` is the folder to which paths
    in the settings refer.

    If the service owns the machine, its latest reading between runs is returned. Raises the errors of
    `read_thermometer`; Busy also if the service has no reading of now, as during a run.
    """
    try:
        return read_thermometer(settings, base), 0.0
    except Busy:
        told = _told_by_service(settings)
        if told is None:
            raise
        return told


def _told_by_service(settings: Settings) -> tuple[dict[str, float], float] | None:
    """Return the readings of the service with their age; None if there are none of now."""
    try:
        with Client(settings) as client:
            status = client.get("/api/status")
    except VolcalError:  # a run of the command line owns the machine, or the service does not answer
        return None
    readings, age_s = status.get("temperatures_c"), status.get("temperatures_age_s")  # earlier versions have neither
    if not (isinstance(readings, dict) and all(map(_is_number, readings.values())) and _is_number(age_s)):
        return None
    return (plausible_readings(readings), float(age_s)) if 0.0 <= age_s <= LONGEST_AGE_S else None


def _is_number(value: object) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool)
