"""Temperatures of the ambient air, the artefact and the machine at any instant.

The temperatures are explicit functions of time, and simulated time may therefore advance in steps of any size.
"""

from __future__ import annotations

import math

from simulators.temperatures import ThermalSettings

S_PER_H = 3600.0
_AT_ONCE_H = 1e-9
_ALIKE = 1e-6  # relative difference of two time constants below which the limit is more exact than the quotient


class ThermalState:
    """True temperatures of ambient air, artefact and machine, without the errors of the thermometers."""

    def __init__(self, settings: ThermalSettings) -> None:
        self._settings = settings
        self.artefact_is_constant = not self._ever_warms(settings.artefact_time_constant_h, settings.artefact_k_per_h)
        self.machine_is_constant = not self._ever_warms(settings.machine_time_constant_h, settings.machine_k_per_h)
        """True if the machine keeps its initial temperature for ever."""

    def ambient_c(self, now_s: float) -> float:
        s = self._settings
        return s.ambient_c + s.ambient_rise_k * first_order_response(now_s / S_PER_H, s.ambient_time_constant_h, 0.0)

    def artefact_c(self, now_s: float) -> float:
        s = self._settings
        if self.artefact_is_constant:
            return s.artefact_c
        return s.artefact_c + self._change_k(now_s, s.artefact_time_constant_h, s.artefact_k_per_h)

    def machine_c(self, now_s: float) -> float:
        s = self._settings
        return s.machine_c + self.machine_change_k(now_s)

    def machine_change_k(self, now_s: float) -> float:
        """Return the change in K, since the start of the simulation, of the true temperature at the place of the
        machine's thermometer.
        """
        s = self._settings
        return self._change_k(now_s, s.machine_time_constant_h, s.machine_k_per_h)

    def body_c(self, name: str, now_s: float) -> float:
        """Return the temperature in °C of a body of the machine that has a thermometer of its own."""
        s = self._settings
        return s.machine_c + self._change_k(now_s, s.body_time_constants_h[name], s.machine_k_per_h)

    def column_change_k(self, now_s: float) -> float:
        """Return the change in K, since the start of the simulation, of the temperature difference between the two
        sides of the column.

        The temperature difference lags behind the temperature at the machine's thermometer, by an additional time
        constant.
        """
        s = self._settings
        lag_h = None if s.machine_time_constant_h is None else s.machine_time_constant_h + s.bend_time_constant_h
        return self._change_k(now_s, lag_h, s.machine_k_per_h)

    def artefact_lag_k(self, now_s: float) -> float:
        """Return the temperature rise of the ambient air minus that of the artefact, both since the start of the
        simulation, in K.

        Returns 0 if the artefact does not follow the ambient temperature.
        """
        s = self._settings
        if s.artefact_time_constant_h is None:
            return 0.0
        return self.ambient_c(now_s) - s.ambient_c - (self.artefact_c(now_s) - s.artefact_c)

    def _ever_warms(self, lag_h: float | None, linear_k_per_h: float) -> bool:
        return linear_k_per_h != 0.0 or (lag_h is not None and self._settings.ambient_rise_k != 0.0)

    def _change_k(self, now_s: float, lag_h: float | None, linear_k_per_h: float) -> float:
        s, hours = self._settings, now_s / S_PER_H
        linear = linear_k_per_h * hours
        if lag_h is None or s.ambient_rise_k == 0.0:
            return linear
        return linear + s.ambient_rise_k * first_order_response(hours, s.ambient_time_constant_h, lag_h)


def first_order_response(hours: float, source_h: float, follower_h: float) -> float:
    """Return the temperature change of a body that follows an ambient change with a first-order lag, as a fraction of
    the final change.

    After t hours the ambient itself has completed the fraction 1 - exp(-t / `source_h`) of its change. `source_h` and
    `follower_h` are the time constants of the ambient and of the body in hours; a time constant of 0 means no lag.
    """
    if hours <= 0.0:
        return 0.0
    slow, fast = max(source_h, follower_h), min(source_h, follower_h)
    if slow < _AT_ONCE_H:
        return 1.0
    if fast <= _ALIKE * slow:
        return -math.expm1(-hours / slow)
    if slow - fast <= _ALIKE * slow:
        # Limit of the formula below for equal time constants: 1 - (1 + t/τ) exp(-t/τ).
        return 1.0 - (1.0 + hours / slow) * math.exp(-hours / slow)
    # Two first-order lags in series: 1 - (τ1 exp(-t/τ1) - τ2 exp(-t/τ2)) / (τ1 - τ2).
    return 1.0 - (slow * math.exp(-hours / slow) - fast * math.exp(-hours / fast)) / (slow - fast)
