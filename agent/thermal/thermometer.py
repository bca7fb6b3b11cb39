"""Statements on the artefact's thermometer: its uncertainty, and the part of the predicted error that is due to it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

from twin.thermal.artefact_temperature import assumed_uncertainty_k
from twin.uncertainty.thermometer_effect import ThermometerEffect
from twin.units import REFERENCE_TEMPERATURE_C


@dataclass(frozen=True)
class ThermometerStatement:
    """Standard uncertainty of the artefact's temperature that an identification uses.

    `was_read` is False if the measurements contain no temperature, so that the artefact counts as 20 °C. `stated` is
    False if nobody stated the uncertainty, so that a large one is assumed.
    """

    standard_uncertainty_k: float
    stated: bool
    was_read: bool = True

    @classmethod
    def of(cls, stated_k: float | None, was_read: bool) -> Self:
        """Return the statement for an uncertainty `stated_k` in K, which is None if nobody stated it."""
        if stated_k is None:
            return cls(assumed_uncertainty_k(was_read), stated=False, was_read=was_read)
        return cls(stated_k, stated=True, was_read=was_read)


@dataclass(frozen=True)
class ThermometerFacts:
    """Effect of the uncertainty of the artefact's temperature on the result of an identification.

    `scale_um_per_m` is the standard uncertainty of the artefact's length that the temperature causes.
    `contribution_um` is the part of the predicted volumetric compensated error (VCE) that is due to the temperature,
    and `vce_if_known_um` is the VCE without this part; both after removal of the best-fitting rigid motion. `stated`
    and `was_read` have the meanings of the fields of `ThermometerStatement`.
    """

    standard_uncertainty_k: float
    stated: bool
    was_read: bool
    scale_um_per_m: float
    contribution_um: float
    vce_if_known_um: float

    @classmethod
    def of(cls, effect: ThermometerEffect, statement: ThermometerStatement) -> Self:
        return cls(
            standard_uncertainty_k=effect.standard_uncertainty_k,
            stated=statement.stated,
            was_read=statement.was_read,
            scale_um_per_m=1e6 * effect.strain,
            contribution_um=effect.contribution.aligned_um,
            vce_if_known_um=effect.without.aligned_um,
        )

    @property
    def text(self) -> str:
        """Sentence for a report."""
        if self.standard_uncertainty_k == 0.0:
            return "Temperature of the artefact: exact, as stated."
        return (
            f"Temperature of the artefact ±{2.0 * self.standard_uncertainty_k:g} K (k = 2): scale "
            f"±{2.0 * self.scale_um_per_m:.1f} µm/m. It contributes {self.contribution_um:.2f} µm to the "
            f"predicted VCE (aligned), which would be {self.vce_if_known_um:.2f} µm if the temperature were known."
        )

    @property
    def short_text(self) -> str:
        """Entry of a summary of a run."""
        source = "as stated" if self.stated else "assumed, not stated"
        return f"±{self.standard_uncertainty_k:g} K ({source}): {self.contribution_um:.2f} µm of the predicted VCE"

    @property
    def warning(self) -> str | None:
        """Warning if the temperature was not measured, or if nobody stated how well; None otherwise."""
        doubt = f"{REFERENCE_TEMPERATURE_C:g} °C ± {2.0 * self.standard_uncertainty_k:g} K (k = 2)"
        if not self.was_read:
            text = f"The temperature of the artefact was not measured: it counts as {doubt}"
            return f"{text}, as stated." if self.stated else f"{text}, as in a workshop without a thermometer."
        if self.stated:
            return None
        return (
            f"The uncertainty of the thermometer is not stated: {2.0 * self.standard_uncertainty_k:g} K (k = 2) is "
            "assumed. State its standard uncertainty, half of U, with "
            "temperature.standard_uncertainty_k in the settings or, for files, --temperature-uncertainty."
        )
