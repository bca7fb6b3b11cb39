"""Identification variants that a study compares. The variants are the options requested by the case, and the published
method with and without a prior."""

from __future__ import annotations

from dataclasses import dataclass, replace

from agent.studies.monte_carlo import with_stated_scales
from twin.identification import Options

PUBLISHED = Options(formulation="distances", weights="unit", use_prior=False)
"""Options of the published method: all distances between the balls of a position, with equal weights and no prior."""


@dataclass(frozen=True, eq=False)
class IdentificationVariant:
    """Identification options that make closed form and simulation comparable.

    All scales of the uncertainties are the stated scales and are not estimated from the measurements.
    """

    options: Options

    @property
    def label(self) -> str:
        prior = "prior" if self.options.use_prior else "no prior"
        return f"{self.options.formulation}, {self.options.weights} weights, {prior}"

    @property
    def title(self) -> str:
        """Label of the variant, marked as the published method if the variant is the published method."""
        published = IdentificationVariant(PUBLISHED).label == self.label
        return f"{self.label} (published method)" if published else self.label


def identification_variants(options: Options) -> tuple[IdentificationVariant, ...]:
    """Return three variants without duplicates: the requested options, the published method with the family of machines
    as prior, and the published method itself."""
    candidates = (options, replace(PUBLISHED, use_prior=True), PUBLISHED)
    found: dict[str, IdentificationVariant] = {}
    for candidate in candidates:
        variant = IdentificationVariant(with_stated_scales(candidate))
        found.setdefault(variant.label, variant)
    return tuple(found.values())
