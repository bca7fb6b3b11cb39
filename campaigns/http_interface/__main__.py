"""Trial of the HTTP interface: requests that schemathesis generates from the OpenAPI document of the service, valid and
invalid ones, with and without the access token.

    python -m campaigns.http_interface [--examples 500] [--seed 1]

The service is a process of its own with a simulated machine behind it, which it really moves: a request that is valid
may start a run, and each operation is followed by an abort without a token. Each response must have a status, a media
type and a content that the document states; no response is a 5xx; an operation that needs the token refuses a request
without it; an abort is accepted at any time. At the end the service must still be there, must have raised nothing
that it did not handle, and the machine must have had no collision.

Streams of events have no end, which a response of schemathesis must have; they are left to the tests.

The output ends with one line of JSON. The exit code is 0 only if nothing was wrong.
"""

from __future__ import annotations

import argparse
import json
import logging
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # must be set before numpy is imported

import structlog

from benchmarks.places import memory_directory
from campaigns.fortnight.incidents import FIRST_EVENING
from campaigns.fortnight.plant import FortnightPlant
from campaigns.fortnight.play import SHORT
from campaigns.fortnight.service_process import STATUS_POLL_S, ServiceHost, wait_for
from campaigns.http_interface.generated_requests import OperationCount, operations_of, try_operation

MAX_LISTED = 20
UNHANDLED = '"level": "critical"', "Traceback (most recent call last)"
"""What the log has if an error was not handled."""


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--examples", type=int, default=500, help="requests of each kind to each operation")
    parser.add_argument("--seed", type=int, default=1, help="number from which the requests are drawn")
    given = parser.parse_args(arguments)
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.ERROR))
    began = perf_counter()
    plant = FortnightPlant(SHORT.scenario, lambda _: 1)
    directory = memory_directory("http-interface")
    with directory as name, ServiceHost(Path(name), plant.ready, SHORT.changes) as host:
        host.set_time(FIRST_EVENING)
        host.serve()
        run_id = host.post("/api/start", {"kind": "calibrate", "consent": True}).raise_for_status().json()["run_id"]
        host.at_rest(run_id)
        counts = []
        for operation in operations_of(host.url):
            counts.append(try_operation(operation, host.token, run_id, given.examples, given.seed))
            print(counts[-1].line(), flush=True)
            bring_to_rest(host)
        log = (host.directory / "service.log").read_text(encoding="utf-8")
        ended = host.stop()
    plant.switch_off()
    result = judged(counts, log) | {"exit_code": ended, "collisions": plant.collisions}
    result["passed"] = result["passed"] and ended == 0 and plant.collisions == 0
    print(json.dumps(result | {"wall_seconds": round(perf_counter() - began, 1)}, allow_nan=False))
    return 0 if result["passed"] else 1


def bring_to_rest(host: ServiceHost) -> None:
    """Abort whatever was started, as a person without a token may at any time, and acknowledge the end.

    Raises httpx.HTTPStatusError if the abort is refused.
    """
    host.post("/api/abort", {"reason": "end of a trial"}, token=False).raise_for_status()
    now = wait_for(host.status_at_rest, "the end of the run", STATUS_POLL_S)
    if "reset" in now["may"]:
        host.post("/api/reset").raise_for_status()


def judged(counts: Sequence[OperationCount], log: str) -> dict[str, object]:
    """Return the numbers of requests, and what was wrong."""
    wrong = [failure for count in counts for failure in count.failures]
    wrong += [f"log: {line[:300]}" for line in log.splitlines() if any(sign in line for sign in UNHANDLED)]
    answers: dict[str, int] = {}
    for count in counts:
        for status, number in count.statuses.items():
            answers[str(status)] = answers.get(str(status), 0) + number
    return {
        "passed": not wrong and bool(counts) and all(count.statuses for count in counts),
        "operations": len(counts),
        "requests": sum(answers.values()),
        "answers": dict(sorted(answers.items())),
        "failures": len(wrong),
        "listed": wrong[:MAX_LISTED],
    }


if __name__ == "__main__":
    sys.exit(main())
