"""Sum of the parts of a campaign that were carried out at different times, each with seeds or numbers of its own.

    python -m campaigns.sum FILE...

Each FILE is the output of one part of `fuzz`, `requests`, `faults`, `plans`, `endurance` or `crash_points`, of which
the last line is read; outputs of other campaigns are refused. The output is one line of JSON of the same form. Numbers
of trials are added, largest and smallest figures stay so, lists are joined, and rates are left out
(`campaigns/sum_rules.py`). What was never accepted was so in no part. Parts with a common seed must not overlap. The
exit code is 0 only if every part has passed and, for requests, each request was accepted in some part.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from campaigns.sum_rules import FORMS, CampaignForm, NotSummableError

NEVER = "never_accepted"
"""Key of the list of what has not happened in any part: if it is not empty, the sum has not passed."""

Document = Mapping[str, Any]


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", type=Path, nargs="+", metavar="FILE", help="output of one part")
    given = parser.parse_args(arguments)
    try:
        total = summed([read_part(path) for path in given.files])
    except (OSError, NotSummableError) as error:
        parser.error(str(error))
    print(json.dumps(total))
    return 0 if total["passed"] else 1


def read_part(path: Path) -> Document:
    """Return the object in the last line of the file. Raises NotSummableError if there is none that says whether the
    part has passed, for example because the part was interrupted, or if it has not the form of a campaign whose parts
    can be summed."""
    lines = path.read_text(encoding="utf-8", errors="replace").split("\n")
    last = next((line for line in reversed(lines) if line.strip()), "")
    try:
        part = json.loads(last)
    except ValueError:
        part = None
    if not isinstance(part, dict) or not isinstance(part.get("passed"), bool):
        raise NotSummableError(f"{path}: the last line is not the result of a campaign; carry out this part again")
    try:
        form_of(part)
    except NotSummableError as error:
        raise NotSummableError(f"{path}: {error}") from None
    return part


def form_of(part: Document) -> CampaignForm:
    """Return the form with exactly the keys of the part. Raises NotSummableError if there is none."""
    for form in FORMS:
        if form.keys == part.keys():
            return form
    if "parts" in part:
        raise NotSummableError("this is a sum already; give the outputs of its parts")
    near = min(FORMS, key=lambda form: len(form.keys ^ part.keys()))
    names = ", ".join(form.name for form in FORMS)
    raise NotSummableError(
        f"this is not the whole output of a campaign that can be summed ({names}); "
        f"{', '.join(sorted(near.keys ^ part.keys()))} is more or less than in an output of {near.name}"
    )


def summed(parts: Sequence[Document]) -> dict[str, Any]:
    """Return the sum of the results of one or more parts. Raises NotSummableError if they are not of one campaign whose
    results can be summed, or if two parts have a trial in common."""
    forms = [form_of(part) for part in parts]
    form = forms[0]
    if any(other is not form for other in forms):
        raise NotSummableError("the files are the output of different campaigns or versions")
    _require_different(form, parts)
    total = {key: rule(key, [part[key] for part in parts]) for key, rule in form.rules.items()}
    total["passed"] = total["passed"] and not total.get(NEVER)
    return {**total, "parts": len(parts)}


def _require_different(form: CampaignForm, parts: Sequence[Document]) -> None:
    """Raise NotSummableError if two parts have a trial in common."""
    if any(parts.count(part) > 1 for part in parts):
        raise NotSummableError("two files are the output of the same part: their results are equal")
    if "seed" not in form.rules:
        return
    if not form.counted_by:
        seeds = [part["seed"] for part in parts]
        if twice := [seed for seed in seeds if seeds.count(seed) > 1]:
            raise NotSummableError(f"two files are the output of the same part: both have the seed {twice[0]}")
        return
    played = sorted(_extent(form, part) for part in parts)
    for (seed, first, count), (other_seed, other_first, _) in pairwise(played):
        if seed == other_seed and other_first < first + count:
            raise NotSummableError(
                f"two files have {form.counted_by} of seed {seed} in common, from number {other_first} on: one has "
                f"{count} from {first} on"
            )


def _extent(form: CampaignForm, part: Document) -> tuple[int, int, int]:
    """Return the seed of a part, the number of its first trial, and the number of its trials."""
    extent = part["seed"], part["first"], part[form.counted_by]
    if not all(isinstance(number, int) for number in extent):
        raise NotSummableError(f"'seed', 'first' and {form.counted_by!r} must be whole numbers, not {extent}")
    return extent


if __name__ == "__main__":
    sys.exit(main())
