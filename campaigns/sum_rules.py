"""Rules by which the results of the parts of a campaign become one, and the campaigns whose results have such rules.

A key without a rule is refused: a ratio or a deviation that is added would be a figure that no part has found.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import fsum
from typing import Any

Rule = Callable[[str, Sequence[Any]], Any]
"""Function that returns the value of the sum from a key and the values that the parts have under it. It raises
NotSummableError if it cannot."""


class NotSummableError(ValueError):
    """Error raised for a file that is not the output of a part, or of another campaign."""


@dataclass(frozen=True)
class CampaignForm:
    """Form of the results of one campaign: the rule of each key. Keys in `dropped` are not in the sum.

    `counted_by` is the key of the number of trials that a part has played from the one with the number `first` on. It
    is empty if a part has no such numbers: a seed may then occur once only.
    """

    name: str
    rules: Mapping[str, Rule]
    counted_by: str = ""
    dropped: frozenset[str] = frozenset()

    @property
    def keys(self) -> frozenset[str]:
        """Keys that each result of the campaign has, no more and no less."""
        return frozenset(self.rules) | self.dropped


def added(key: str, values: Sequence[Any]) -> int | float:
    """Return the sum of numbers; 9 decimals, so that 0.1 and 0.2 are 0.3."""
    numbers = _numbers(key, values)
    return sum(numbers) if all(isinstance(one, int) for one in numbers) else round(fsum(numbers), 9)


def largest(key: str, values: Sequence[Any]) -> int | float:
    """Return the largest number."""
    return max(_numbers(key, values))


def smallest_if_any(key: str, values: Sequence[Any]) -> int | float | None:
    """Return the smallest number. A part that has measured nothing has None, and does not count."""
    return min(_numbers(key, [value for value in values if value is not None]), default=None)


def worst_code(key: str, values: Sequence[Any]) -> int | float:
    """Return the exit code that is farthest from 0: that of a process killed by a signal is negative."""
    return max(_numbers(key, values), key=abs)


def all_true(key: str, values: Sequence[Any]) -> bool:
    """Return True if all truth values are True."""
    return all(_checked(key, values, bool))


def listed(_: str, values: Sequence[Any]) -> list[Any]:
    """Return the values themselves, one for each part."""
    return list(values)


def joined(key: str, values: Sequence[Any]) -> list[Any]:
    """Return all entries of the lists."""
    return [entry for value in _checked(key, values, list) for entry in value]


def in_every(key: str, values: Sequence[Any]) -> list[Any]:
    """Return the entries that are in all lists."""
    first, *others = _checked(key, values, list)
    return [entry for entry in first if all(entry in other for other in others)]


def place_by_place(rule: Rule) -> Rule:
    """Return a rule for lists of equal length, which applies `rule` to their first entries, their second ones and so
    on."""

    def applied(key: str, values: Sequence[Any]) -> list[Any]:
        if len({len(value) for value in _checked(key, values, list)}) > 1:
            raise NotSummableError(f"{key!r} has not the same length in all parts")
        return [rule(key, entries) for entries in zip(*values, strict=True)]

    return applied


def by_name(rule: Rule) -> Rule:
    """Return a rule for objects with any keys, which applies `rule` to the values of each key in those parts that have
    it."""

    def applied(key: str, values: Sequence[Any]) -> dict[str, Any]:
        names = dict.fromkeys(name for value in _checked(key, values, dict) for name in value)
        return {name: rule(f"{key}.{name}", [value[name] for value in values if name in value]) for name in names}

    return applied


def by_key(rules: Mapping[str, Rule]) -> Rule:
    """Return a rule for objects with the keys of `rules`."""

    def applied(key: str, values: Sequence[Any]) -> dict[str, Any]:
        for value in _checked(key, values, dict):
            if different := value.keys() ^ rules.keys():
                raise NotSummableError(f"{key!r} has other keys than in this version: {', '.join(sorted(different))}")
        return {name: rule(f"{key}.{name}", [value[name] for value in values]) for name, rule in rules.items()}

    return applied


def _checked(key: str, values: Sequence[Any], expected: type) -> Sequence[Any]:
    """Return `values`, which must all be of the type `expected`."""
    for value in values:
        if not isinstance(value, expected):
            raise NotSummableError(f"{key!r} is {value!r}, which has no sum")
    return values


def _numbers(key: str, values: Sequence[Any]) -> Sequence[int | float]:
    for value in values:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise NotSummableError(f"{key!r} is {value!r}, which is not a number")
    return values


COUNTS = by_name(added)
PASSED: Mapping[str, Rule] = {"passed": all_true}
SEED: Mapping[str, Rule] = {"seed": listed}
FIRST: Mapping[str, Rule] = {**SEED, "first": listed}
WALL: Mapping[str, Rule] = {"wall_seconds": added}
CPU: Mapping[str, Rule] = {"cpu_s": added, **WALL}

DECODER: Mapping[str, Rule] = {
    **dict.fromkeys(("read", "refused", "cpu_s"), added),
    **dict.fromkeys(("slowest_cpu_s", "grown_kib"), largest),
    "failures": joined,
}

FORMS: Sequence[CampaignForm] = (
    CampaignForm("fuzz", {**PASSED, "inputs": added, "decoders": by_name(by_key(DECODER)), **SEED, **WALL}),
    CampaignForm(
        "requests",
        {
            **PASSED,
            **dict.fromkeys(("steps", "trials", "violations"), added),
            **FIRST,
            **dict.fromkeys(("by_action", "accepted", "refusals", "by_state", "runs_by_end"), COUNTS),
            "violated": joined,
            "never_accepted": in_every,  # it was accepted if it was in one part
            **CPU,
        },
        counted_by="trials",
    ),
    CampaignForm(
        "faults",
        {
            **PASSED,
            **dict.fromkeys(("nights", "reached", "with_a_second_fault", "resumed", "resumed_twice"), added),
            **dict.fromkeys(("resumption_refused", "accepted", "left_to_the_morning", "left_to_a_person"), added),
            **dict.fromkeys(
                (
                    "misled_by_a_thermometer",
                    "altered_but_better",
                    "not_shown",
                    "struck_a_displaced_ball",
                    "machines_refused",
                ),
                added,
            ),
            **dict.fromkeys(("by_group", "by_kind", "ended", "resumed_to", "cannot_be_seen", "violations"), COUNTS),
            **FIRST,
            **CPU,
        },
        counted_by="nights",
    ),
    CampaignForm(
        "plans",
        {
            **PASSED,
            **dict.fromkeys(("plans", "accepted", "completed", "judged", "judged_collisions"), added),
            **dict.fromkeys(("commands", "machine_hours", "judge_compared", "judge_collisions"), added),
            **dict.fromkeys(("accepted_by_spindle", "refused", "stopped", "branches", "interrupted"), COUNTS),
            **dict.fromkeys(("failed_seeds", "judge_disagrees"), joined),
            "smallest_clearance_mm": smallest_if_any,
            **FIRST,
            **WALL,
        },
        counted_by="plans",
        dropped=frozenset({"plans_per_second"}),
    ),
    CampaignForm(
        "endurance",
        {
            **PASSED,
            **dict.fromkeys(("runs", "compacted", "collisions"), added),
            "ended_well": all_true,
            "lost": joined,
            "exit_code": worst_code,
            "memory_growth_mb_per_run": largest,
            **dict.fromkeys(("memory_mb", "handles", "threads"), place_by_place(largest)),
            **dict.fromkeys(("disk_mb_per_run", "cpu_s_per_run"), by_name(place_by_place(largest))),
            **WALL,
        },
    ),
    CampaignForm(
        "crash_points",
        {
            **PASSED,
            "points": largest,  # every part passes the same crash points, of which it selects others
            "points_by_kind": by_name(largest),
            **dict.fromkeys(("kills", "resumed", "resumed_and_accepted"), added),
            **dict.fromkeys(("resumption_refused", "unproved_at_the_kill"), added),
            **dict.fromkeys(("kills_by_kind", "resumed_to", "violations"), COUNTS),
            **SEED,
            **CPU,
        },
    ),
    CampaignForm(
        "crash_points --kind processes",
        {
            **PASSED,
            **dict.fromkeys(("kills", "resumed", "given_up", "accepted", "left_to_a_person"), added),
            **dict.fromkeys(("kills_by_kind", "kills_by_work", "violations"), COUNTS),
            **SEED,
            **WALL,
        },
    ),
)
"""Forms of the campaigns whose results can be summed."""
