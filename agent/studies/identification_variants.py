"""The ways of identification that stand side by side in a study: the one asked for and the published one."""

from __future__ import annotations

from dataclasses import dataclass, replace

from agent.studies.monte_carlo import as_stated
from twin.identification import Options

PUBLISHED = Options(formulation="distances", weights="unit", use_prior=False)
"""All distances of a position alike, nothing known of the machine."""


@dataclass(frozen=True, eq=False)
class Way:
    """How to identify, with scales as stated: what closed form and simulation both speak of."""

    options: Options

    @property
    def label(self) -> str:
        prior = "prior" if self.options.use_prior else "no prior"
        return f"{self.options.formulation}, {self.options.weights} weights, {prior}"

    @property
    def title(self) -> str:
        """The label, saying which way is the published one."""
        published = Way(PUBLISHED).label == self.label
        return f"{self.label} (published method)" if published else self.label


def ways(options: Options) -> tuple[Way, ...]:
    """The way asked for first, then the published method with the family as prior, then as published; each once."""
    candidates = (options, replace(PUBLISHED, use_prior=True), PUBLISHED)
    found: dict[str, Way] = {}
    for candidate in candidates:
        way = Way(as_stated(candidate))
        found.setdefault(way.label, way)
    return tuple(found.values())
