"""Claims of the publication as numbers, and what the data say of each.

A claim has one value for each machine, reading of the method and measure of the volumetric error. Whether it holds is
decided by the root mean square over machines in closed form, as in the figures of the publication; the band and the
share of the machines say how far single machines differ.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from agent.studies.measure import share_of_gain
from agent.studies.published.procedures import (
    COUNTS,
    REFERENCE_SET,
    STRAIGHT_DEG,
    TILTED_DEG,
    Outcomes,
    ProcedureKey,
    bent,
)
from twin.arrays import Array
from twin.artefact.position_set import SET_EXPRESSIONS

PUBLISHED_BALLS = 7
SUFFICIENT_SHARE = 0.95
MUCH = 0.2
HARDLY = 0.05
BAND_PERCENT = (5.0, 95.0)
FACTORS = ("machine", "reading", "measure")

HOLDS, DOES_NOT_HOLD, DEPENDS = "holds", "does not hold", "depends on"


@dataclass(frozen=True)
class ClaimFinding:
    """Value of one claim on one machine, in one reading and one measure.

    `value` is None if a procedure of the claim identifies nothing. `band` contains its 5 % and 95 % quantiles over
    single machines, and `share` the share of the machines for which the claim holds. `answer` is the value in words if
    it is not a number.
    """

    machine: str
    reading: str
    measure: str
    value: float | None
    holds: bool
    band: tuple[float, float] | None = None
    share: float | None = None
    answer: str = ""


@dataclass(frozen=True, eq=False)
class Claim:
    """Claim of the publication: `section` and `text` say what it claims, and `criterion` how it is decided here.

    `values` takes the errors (procedures, m) of m machines and their errors (m,) before compensation, and returns one
    value for each; `within` says for which values the claim holds.
    """

    name: str
    section: str
    text: str
    criterion: str
    keys: tuple[ProcedureKey, ...]
    values: Callable[[Array, Array], Array]
    within: Callable[[Array], Array]

    def examine(self, outcomes: Outcomes) -> ClaimFinding:
        """Return what the errors of one machine, reading and measure say of this claim."""
        where = (outcomes.machine, reading_of(outcomes), outcomes.measure.key)
        expected = [value for value in outcomes.expected(*self.keys) if value is not None]
        machines = outcomes.machines(*self.keys)
        if machines is None:
            return ClaimFinding(*where, None, False)
        value = self.values(np.array(expected)[:, None], np.array([outcomes.before_um]))
        each = self.values(machines, outcomes.machines_before_um)
        low, high = np.percentile(each, BAND_PERCENT).tolist()
        return ClaimFinding(
            *where, float(value[0]), bool(self.within(value)[0]), (low, high), float(np.mean(self.within(each)))
        )


def reading_of(outcomes: Outcomes) -> str:
    """Return "published" for the reading of the published method, else "volcal"."""
    return "published" if outcomes.variant.is_published else "volcal"


def _share_of_seven(left: Array, before: Array) -> Array:
    shares = [
        share_of_gain(column.tolist(), float(start))[COUNTS.index(PUBLISHED_BALLS)]
        for column, start in zip(left.T, before, strict=True)
    ]
    return np.array([0.0 if share is None else share for share in shares])


def _saving(left: Array, _: Array) -> Array:
    return np.asarray(1.0 - left[1] / left[0])


def _smallest_step(left: Array, _: Array) -> Array:
    """Return the smaller of the two reductions from 3 to 5 and from 5 to 11 balls, as a share of the error before."""
    return np.asarray(np.minimum(1.0 - left[1] / left[0], 1.0 - left[2] / left[1]))


def _tilts(name: str) -> tuple[ProcedureKey, ProcedureKey]:
    return ProcedureKey(name, tilt_deg=STRAIGHT_DEG), ProcedureKey(name, tilt_deg=TILTED_DEG)


CLAIMS = (
    Claim(
        "balls",
        "5.1, fig. 6",
        "7 balls give 95 % of the gain",
        f"share of the largest gain of {COUNTS[0]} to {COUNTS[-1]} balls in S3 is at least {SUFFICIENT_SHARE:g}",
        tuple(ProcedureKey(REFERENCE_SET, balls=count) for count in COUNTS),
        _share_of_seven,
        lambda value: np.asarray(value >= SUFFICIENT_SHARE),
    ),
    Claim(
        "trajectory",
        "5.1, fig. 7",
        "C follows M better with 5 balls than with 3, and with 11 than with 5",
        "the smaller of the two reductions of the VCE over the workspace is above 0",
        tuple(ProcedureKey(REFERENCE_SET, balls=count) for count in (3, 5, 11)),
        _smallest_step,
        lambda value: np.asarray(value > 0.0),
    ),
    Claim(
        "tilt S2",
        "5.2, fig. 8",
        "tilted holders matter much for S2",
        f"30° reduce the VCE of a straight bar by at least {MUCH:g}",
        _tilts("S2"),
        _saving,
        lambda value: np.asarray(value >= MUCH),
    ),
    Claim(
        "tilt S2+S3",
        "5.2, fig. 8",
        "tilted holders hardly matter for S2+S3",
        f"30° change the VCE of a straight bar by at most {HARDLY:g}",
        _tilts("S2+S3"),
        _saving,
        lambda value: np.asarray(np.abs(value) <= HARDLY),
    ),
)

SETS = tuple(ProcedureKey(name) for name in SET_EXPRESSIONS)
CHOICE = "sets"
DIFFERENCE = "criteria"
TEXTS = {
    **{claim.name: (claim.section, claim.text, claim.criterion) for claim in CLAIMS},
    CHOICE: (
        "5.3, fig. 9",
        "S3 is the best choice of S1, S2, S3 and their combinations",
        "S3 is at the bend of the Pareto front of ball centres and VCE; the value is its share of the largest gain",
    ),
    DIFFERENCE: (
        "6",
        "the best choice differs between machines",
        "the fewest balls with 95 % of the gain, or the set at the bend, are not those of all machines",
    ),
}
"""Name → section of the publication, claim and criterion."""


def choice_of_set(outcomes: Outcomes) -> ClaimFinding:
    """Return whether S3 is at the bend of cost and error, and its share of the gain of the best combination."""
    where = (outcomes.machine, reading_of(outcomes), outcomes.measure.key)
    machines, costs = outcomes.machines(*SETS), outcomes.costs(*SETS)
    if machines is None:
        return ClaimFinding(*where, None, False)
    expected = [value or 0.0 for value in outcomes.expected(*SETS)]
    at, chosen = SET_EXPRESSIONS.index(REFERENCE_SET), bent(costs, expected)
    each = [
        share_of_gain(column.tolist(), float(start))[at] or 0.0
        for column, start in zip(machines.T, outcomes.machines_before_um, strict=True)
    ]
    low, high = np.percentile(each, BAND_PERCENT).tolist()
    share = float(np.mean([bent(costs, column.tolist()) == at for column in machines.T]))
    value = share_of_gain(expected, outcomes.before_um)[at]
    return ClaimFinding(*where, value, chosen == at, (low, high), share, SET_EXPRESSIONS[chosen])


def fewest_balls(outcomes: Outcomes) -> int | None:
    """Return the smallest of the examined numbers of balls with 95 % of the gain, or None."""
    keys = [ProcedureKey(REFERENCE_SET, balls=count) for count in COUNTS]
    shares = zip(COUNTS, share_of_gain(outcomes.expected(*keys), outcomes.before_um), strict=True)
    return next((count for count, share in shares if share is not None and share >= SUFFICIENT_SHARE), None)


def differences(every: Sequence[Outcomes], choices: Sequence[ClaimFinding]) -> list[ClaimFinding]:
    """Return, for each machine, reading and measure, whether its best number of balls or its best set differs from that
    of another machine. `choices` contains the finding on the sets for each outcome."""
    answers = {
        (
            choice.machine,
            choice.reading,
            choice.measure,
        ): f"{fewest_balls(one) or 'no number of'} balls, {choice.answer}"
        for one, choice in zip(every, choices, strict=True)
    }
    return [
        ClaimFinding(
            *where, None, any(other != answer for at, other in answers.items() if at[1:] == where[1:]), answer=answer
        )
        for where, answer in answers.items()
    ]


def examine(every: Sequence[Outcomes]) -> dict[str, list[ClaimFinding]]:
    """Return the findings by name of the claim."""
    choices = [choice_of_set(one) for one in every]
    return {
        **{claim.name: [claim.examine(one) for one in every] for claim in CLAIMS},
        CHOICE: choices,
        DIFFERENCE: differences(every, choices),
    }


def verdicts_by_place(findings: Sequence[ClaimFinding]) -> dict[tuple[str, str], str]:
    """Return the verdict over the measures for each pair of machine and reading."""
    places = dict.fromkeys((one.machine, one.reading) for one in findings)
    return {place: verdict([one for one in findings if (one.machine, one.reading) == place]) for place in places}


def verdict(findings: Sequence[ClaimFinding]) -> str:
    """Return "holds", "does not hold", or "depends on" with the factors (machine, reading, measure) that alone change
    the finding; if only a change of several does, all are named."""
    if len({one.holds for one in findings}) == 1:
        return HOLDS if findings[0].holds else DOES_NOT_HOLD
    deciding = [factor for number, factor in enumerate(FACTORS) if _decides(findings, number)]
    *others, last = deciding or FACTORS
    return f"{DEPENDS} {', '.join(others)}{' and ' if others else ''}{last}"


def _decides(findings: Sequence[ClaimFinding], number: int) -> bool:
    """Return True if two findings that differ in one factor alone contradict each other."""
    held: dict[tuple[str, ...], set[bool]] = {}
    for one in findings:
        where = [one.machine, one.reading, one.measure]
        del where[number]
        held.setdefault(tuple(where), set()).add(one.holds)
    return any(len(found) > 1 for found in held.values())
