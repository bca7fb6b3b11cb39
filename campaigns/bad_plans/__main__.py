"""Trial of every bad plan. The last output line is JSON and lists the plans that were not refused for the right reason.

python -m campaigns.bad_plans
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path
from time import perf_counter

from campaigns.bad_plans.catalogue import bad_plans


def main() -> int:
    began, wrong = perf_counter(), {}
    plans = bad_plans()
    for bad in plans:
        with tempfile.TemporaryDirectory(prefix="volcal-bad-") as directory:
            complaint = bad.complaint(Path(directory))
        if complaint:
            wrong[bad.name] = complaint
    result = {
        "passed": not wrong,
        "bad_plans": len(plans),
        "refused_right": len(plans) - len(wrong),
        "wrong": wrong,
        "wall_seconds": round(perf_counter() - began, 1),
    }
    print(json.dumps(result, allow_nan=False))
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
