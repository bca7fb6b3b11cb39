"""Effect of each property of an artefact and its mount on the expected error, from all variants that were screened.

The position set of each variant comes from a search that ends in a local optimum, so that two variants of the same
worth differ by one or two percent. The mean over all pairs of variants that differ in one property alone is more
reliable than a single pair.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from agent.planning.design.artefact_screening import ScreenedVariant
from agent.planning.design.artefact_search import PROPERTIES
from agent.planning.design.artefact_variants import ArtefactVariant


@dataclass(frozen=True)
class PropertyEffect:
    """Effect of the change of the property called `name` from that of the best variant to that of `changed`, which
    differs from it in this property alone.

    `ratios` are the expected errors after the change over those before it, one for each pair of measurable variants
    that differ like this.
    """

    name: str
    best: ArtefactVariant
    changed: ScreenedVariant
    ratios: tuple[float, ...]

    @property
    def values(self) -> tuple[object, object]:
        """Value of the property before and after the change."""
        return getattr(self.best, self.name), getattr(self.changed.variant, self.name)

    @property
    def mean_percent(self) -> float | None:
        """Geometric mean of the changes of the expected error in percent; None without a pair."""
        if not self.ratios:
            return None
        return 100.0 * (math.exp(math.fsum(map(math.log, self.ratios)) / len(self.ratios)) - 1.0)


def property_effects(
    best: ArtefactVariant, changes: Sequence[ScreenedVariant], screened: Sequence[ScreenedVariant]
) -> tuple[PropertyEffect, ...]:
    """Return the effect of each of `changes`, which differ from `best` in one property, over all variants in
    `screened`."""
    errors_um = {one.variant: one.vce_um for one in screened if one.measurable}
    effects = []
    for changed in changes:
        name = next(name for name in PROPERTIES if getattr(changed.variant, name) != getattr(best, name))
        before, after = getattr(best, name), getattr(changed.variant, name)
        pairs = ((one, replace(one, **{name: after})) for one in errors_um if getattr(one, name) == before)
        ratios = tuple(errors_um[other] / errors_um[one] for one, other in pairs if other in errors_um)
        effects.append(PropertyEffect(name, best, changed, ratios))
    return tuple(effects)
