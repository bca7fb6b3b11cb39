"""Identification variants that a study compares. The variants are the identification options of the study's case, and
the published method with and without a prior."""

from __future__ import annotations

from dataclasses import dataclass, replace

from agent.studies.monte_carlo import with_stated_scales
from twin.identification import Options

PUBLISHED = Options(formulation="distances", weights="unit", use_prior=False)
"""Options of the published method: all distances between the balls of a position, with equal weights and no prior."""


@dataclass(frozen=True, eq=False)
class IdentificationVariant:
    """Identification options for which the volumetric error after compensation computed in closed form and the
    simulated one are comparable.

    All uncertainties are used as stated; no scale factors for them are estimated from the measurements.
    """

    options: Options

    @property
    def label(self) -> str:
        prior = "prior" if self.options.use_prior else "no prior"
        return f"{self.options.formulation}, {self.options.weights} weights, {prior}"

    @property
    def title(self) -> str:
        """Label of the identification variant in figures. The label of the published method also says that it is the
        published method."""
        published = IdentificationVariant(PUBLISHED).label == self.label
        return f"{self.label} (published method)" if published else self.label


def identification_variants(options: Options) -> tuple[IdentificationVariant, ...]:
    """Return the identification variants to compare, without duplicates.

    They are the given `options`, the published method with the family of machines as prior, and the published method
    without a prior.
    """
    candidates = (options, replace(PUBLISHED, use_prior=True), PUBLISHED)
    found: dict[str, IdentificationVariant] = {}
    for candidate in candidates:
        variant = IdentificationVariant(with_stated_scales(candidate))
        found.setdefault(variant.label, variant)
    return tuple(found.values())
