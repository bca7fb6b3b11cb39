"""Sum of the parts of a campaign that were carried out at different times, each with seeds or numbers of its own.

    python -m campaigns.sum FILE...

Each FILE is the output of one part, of which the last line is read. The output is one line of JSON of the same form:
numbers are added, maxima stay maxima, lists are joined. What was never accepted was so in no part. The exit code is 0
only if every part has passed and, for requests, each request was accepted in some part.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from functools import reduce
from pathlib import Path
from typing import Any

MAXIMA = frozenset(
    {
        *("slowest_cpu_s", "grown_kib", "exit_code", "handles", "threads"),
        *("points", "points_by_kind"),  # every part passes the same crash points, of which it selects others
        *("memory_mb", "memory_growth_mb_per_run", "disk_mb_per_run", "cpu_s_per_run"),
    }
)
"""Keys of figures of which the largest one of all parts counts."""
IDENTIFYING = frozenset({"seed", "first"})
"""Keys of what distinguishes the parts; the sum lists them."""
IN_NO_PART = frozenset({"never_accepted"})
"""Keys of lists of what has not happened: it has happened if it has in one part."""

Document = Mapping[str, Any]


class NotSummableError(ValueError):
    """Error raised for a file that is not the output of a part, or of another campaign."""


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
    part has passed, for example because the part was interrupted."""
    lines = path.read_text(encoding="utf-8").split("\n")
    last = next((line for line in reversed(lines) if line.strip()), "")
    try:
        part = json.loads(last)
    except ValueError:
        part = None
    if not isinstance(part, dict) or not isinstance(part.get("passed"), bool):
        raise NotSummableError(f"{path}: the last line is not the result of a campaign; carry out this part again")
    return part


def summed(parts: Sequence[Document]) -> dict[str, Any]:
    """Return the sum of the results of one or more parts. Raises NotSummableError if their forms differ, or if a part
    is there twice."""
    listed = [{**part, **{key: [part[key]] for key in IDENTIFYING & part.keys()}} for part in parts]
    if len({frozenset(part) for part in listed}) > 1:
        raise NotSummableError("the files are the output of different campaigns or versions")
    identities = [tuple(part[key] for key in sorted(IDENTIFYING & part.keys())) for part in parts]
    if any(identity and identities.count(identity) > 1 for identity in identities):
        raise NotSummableError("two files are the output of the same part: their seeds and first numbers are equal")
    total: dict[str, Any] = reduce(lambda one, other: _sum(one, other, ""), listed)
    total["passed"] = total["passed"] and not any(total.get(key) for key in IN_NO_PART)
    return {**total, "parts": len(parts)}


def _sum(one: Any, other: Any, key: str) -> Any:
    """Return the sum of two values that two parts have under `key`."""
    if isinstance(one, dict) and isinstance(other, dict):
        names = [*one, *(name for name in other if name not in one)]
        return {name: _joined(one, other, name, key if key in MAXIMA else name) for name in names}
    if isinstance(one, list) and isinstance(other, list):
        return _sum_of_lists(one, other, key)
    if isinstance(one, bool) and isinstance(other, bool):
        return one and other
    if _is_number(one) and _is_number(other):
        return max(one, other) if key in MAXIMA else round(one + other, 9)
    if one == other:
        return one
    raise NotSummableError(f"{key!r} is {one!r} in one part and {other!r} in another")


def _sum_of_lists(one: list[Any], other: list[Any], key: str) -> list[Any]:
    if key in IN_NO_PART:
        return [entry for entry in one if entry in other]
    if key in MAXIMA:
        return [max(pair) for pair in zip(one, other, strict=True)]
    return one + other


def _joined(one: Document, other: Document, name: str, key: str) -> Any:
    if name not in other:
        return one[name]
    return _sum(one[name], other[name], key) if name in one else other[name]


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


if __name__ == "__main__":
    sys.exit(main())
