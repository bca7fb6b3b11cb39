"""The ways of identification that stand side by side in a study: the one asked for and the published one."""

from __future__ import annotations

from dataclasses import dataclass, replace

from agent.studies.monte_carlo import with_stated_scales
from twin.identification import Options

PUBLISHED = Options(formulation="distances", weights="unit", use_prior=False)
"""All distances of a position alike, nothing known of the machine."""


@dataclass(frozen=True, eq=False)
class IdentificationVariant:
    """How to identify, with scales as stated: what closed form and simulation both speak of."""

    options: Options

    @property
    def label(self) -> str:
        prior = "prior" if self.options.use_prior else "no prior"
        return f"{self.options.formulation}, {self.options.weights} weights, {prior}"

    @property
    def title(self) -> str:
        """The label, saying which variant is the published one."""
        published = IdentificationVariant(PUBLISHED).label == self.label
        return f"{self.label} (published method)" if published else self.label


def identification_variants(options: Options) -> tuple[IdentificationVariant, ...]:
    """The variant asked for first, then the published method with the family as prior, then as published; each once."""
    candidates = (options, replace(PUBLISHED, use_prior=True), PUBLISHED)
    found: dict[str, IdentificationVariant] = {}
    for candidate in candidates:
        variant = IdentificationVariant(with_stated_scales(candidate))
        found.setdefault(variant.label, variant)
    return tuple(found.values())
