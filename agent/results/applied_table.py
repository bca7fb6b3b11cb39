"""Diagnosis of the correction that the controller applies, from the change of held-out balls made by the new table."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from agent.probing.measured_balls import Correction, no_correction
from twin.arrays import Array
from twin.artefact.change_test import DECISIVE_ODDS, ChangeTest, odds_text
from twin.compensation.misread_tables import NO_EFFECT, misread_tables
from twin.compensation.table import CompensationTable

_NAMED_BEFORE_SHARE = 100.0
"""Odds of a named mistake against an arbitrary share of the correction, before anything is measured."""

_FORMER_ACTS = "the former table still acts: the controller has not activated the new one"
_BOTH_ACT = "the former and the new table act together: the controller has not deactivated the former one"
BANK_DOUBTED = "the bank that the controller reports as active is not the one that acts"
"""Conclusion from a change of the balls that the new table cannot have made, however it is read."""


@dataclass(frozen=True)
class AppliedTable:
    """Comparison of the change that a new table made with the change that it should make.

    `chi2_normalised` is χ² of the change per degree of freedom, and `limit` the largest value of a table that is
    applied as written. `mistake` is the mistake of the controller that explains the change better; it is empty if the
    odds against the table as written, `odds`, are not decisive. They are those of one of many possible mistakes.
    """

    chi2_normalised: float
    limit: float
    mistake: str = ""
    odds: str = ""

    @property
    def reason(self) -> str:
        """Reason why the controller does not apply the new table as written; empty if it does.

        If the bank that the controller reports does not act, no later report that the former bank is active again
        proves it. The reason then says so, and what to do.
        """
        if self.mistake:
            found = f"{self.mistake} (odds against the table as written: {self.odds})"
        elif self.chi2_normalised > self.limit:
            found = (
                "the held-out positions did not change as the table should change them: normalised χ² of the change "
                f"{self.chi2_normalised:.2f}, allowed {self.limit:.2f}"
            )
        else:
            return ""
        if self.mistake not in ("", NO_EFFECT, _FORMER_ACTS, _BOTH_ACT):
            return found
        instruction = "see at the controller that the former compensation acts again"
        return (
            f"{found}; so {BANK_DOUBTED} or does not act as written, or the machine or the artefact has changed during "
            f"the proof: {instruction}"
        )


def applied_table(
    test: ChangeTest,
    table: CompensationTable,
    former: Correction,
    projected: Callable[[Correction], Array],
    max_chi2: float,
) -> AppliedTable:
    """Return which correction the controller applies, after it was to replace the correction `former` by `table`.

    `projected` gives the corrections at the held-out balls, projected on the directions of the test (f,) in mm.
    `max_chi2` is the stated limit of a normalised χ².
    """
    mistakes = [(mistake, projected(correction)) for mistake, correction in _mistakes(table, former)]
    return diagnosed(test, projected(table.at), mistakes, max_chi2)


def diagnosed(test: ChangeTest, written: Array, mistakes: Sequence[tuple[str, Array]], max_chi2: float) -> AppliedTable:
    """Return whether the correction `written` is applied, any other share of it, or one of the `mistakes`, each with
    its name. All corrections (f,) in mm are projected on the directions of the test."""
    chi2, limit = test.chi2_normalised(written), test.limit(max_chi2)
    share = test.share(written)
    named = [
        *mistakes,
        (f"{100.0 * share:.0f} % of the correction acts: check the scale of the table", share * written),
    ]
    odds = test.log_odds([correction for _, correction in named], written)
    odds[-1] -= math.log(_NAMED_BEFORE_SHARE)
    best = int(np.argmax(odds))
    log_odds, mistake = float(odds[best]), named[best][0]
    if best < len(mistakes):
        # The best of many explains the noise better than any one: all of them together count as much as one alone.
        log_odds -= math.log(len(mistakes))
    if log_odds < math.log(DECISIVE_ODDS):
        return AppliedTable(chi2, limit)
    return AppliedTable(chi2, limit, mistake, odds_text(log_odds))


def _mistakes(table: CompensationTable, former: Correction) -> Iterator[tuple[str, Correction]]:
    for misread in misread_tables(table):
        yield misread.mistake, misread.table.at
    if former is no_correction:
        return
    yield _FORMER_ACTS, former
    yield _BOTH_ACT, lambda points: former(points) + table.at(points)
