"""Identification variants that a study compares. The variants are the identification options of the study's case, a
reading of the published method, and unweighted distances with and without a prior."""

from __future__ import annotations

from dataclasses import dataclass, replace

from agent.studies.monte_carlo import with_stated_scales
from twin.identification import Options
from twin.uncertainty.truth_assumptions import TruthAssumptions

UNWEIGHTED = Options(formulation="distances", weights="unit", use_prior=False)
"""Options for all distances between the balls of a position, with equal weights, no prior and no restraint of poorly
determined directions."""

PUBLISHED = replace(UNWEIGHTED, cut_off=1e-2)
"""Options of the published method, as its text is read here: all distances between the balls of a position with equal
weights and no prior, solved with truncated singular values for the parameters of smallest norm in units of the
family."""

PUBLISHED_STUDIES = ("volumetric-error", "ball-count", "trajectory", "misalignment", "strategy")
"""Names of the studies that the publication contains, for which its method can be selected."""


@dataclass(frozen=True, eq=False)
class IdentificationVariant:
    """Identification options for which the volumetric error after compensation computed in closed form and the
    simulated one are comparable.

    All uncertainties are used as stated; no scale factors for them are estimated from the measurements.
    """

    options: Options

    @property
    def is_published(self) -> bool:
        """True for the reading of the published method, which truncates the singular values."""
        return self.options.cut_off is not None

    @property
    def label(self) -> str:
        if self.is_published:
            return f"published, cut-off {self.options.cut_off:g}"
        prior = "prior" if self.options.use_prior else "no prior"
        return f"{self.options.formulation}, {self.options.weights} weights, {prior}"

    @property
    def title(self) -> str:
        """Label of the identification variant in figures. The label of the published method also says that it is a
        reading of the publication."""
        return f"{self.label} (as read; perfect touches and certificate)" if self.is_published else self.label

    def assumptions(self, stated: TruthAssumptions) -> TruthAssumptions:
        """Return the assumptions about the true conditions under which this variant is evaluated.

        They are those `stated`. The published method is evaluated with perfect touches and a perfect artefact, as in
        the publication: without touch noise and without errors of the certificate and of the coefficient of thermal
        expansion.
        """
        return replace(stated, touch_noise=False, certificate=False, cte=False) if self.is_published else stated


def identification_variants(options: Options) -> tuple[IdentificationVariant, ...]:
    """Return the identification variants to compare, without duplicates.

    They are the given `options`, the published method, and unweighted distances with the family of machines as prior
    and without a prior.
    """
    candidates = (options, PUBLISHED, replace(UNWEIGHTED, use_prior=True), UNWEIGHTED)
    found: dict[str, IdentificationVariant] = {}
    for candidate in candidates:
        variant = IdentificationVariant(with_stated_scales(candidate))
        found.setdefault(variant.label, variant)
    return tuple(found.values())
