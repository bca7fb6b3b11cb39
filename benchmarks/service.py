"""The service at real speed: abort to stop command, overhead of a step, share of a core, memory. One JSON line.

`volcal serve` and `volcal simulate` are processes of their own on the wall clock, four clients poll the status. The
stop command has been sent before the state says aborting, so the event of that state bounds it from above.
"""

from __future__ import annotations

import argparse
import json
import os
import sqlite3
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from itertools import pairwise
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "system"))
from service_process import COMMAND, Service, service, short_settings
from test_kill import SCENARIO

TICKS_PER_S = os.sysconf("SC_CLK_TCK")
POLLING_CLIENTS = 4
POLL_EVERY_S = 0.05
FIRST_TOUCH_WITHIN_S = 300.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--aborts", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=30.0, help="of idling, and of a run that is measured")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, real_speed(Path(folder)) as running:
        figures = idle(running, chosen.seconds)
        with polled(running):
            latencies = sorted(abort_latency_ms(running) for _ in range(chosen.aborts))
        figures["abort_to_stop_ms_median"] = latencies[len(latencies) // 2]
        figures["abort_to_stop_ms_worst"] = latencies[-1]
        figures["aborts"] = len(latencies)
        figures |= measured(running, chosen.seconds)
    print(json.dumps({name: round(value, 3) for name, value in figures.items()}))


@contextmanager
def real_speed(directory: Path) -> Iterator[Service]:
    arguments = ["--can", "socketcand:127.0.0.1:0", "--clock", "real", "--end-with-stdin"]
    command = [*COMMAND, "simulate", "--config", str(SCENARIO), *arguments]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as simulator:  # noqa: S603
        try:
            assert simulator.stdout is not None
            ready = json.loads(simulator.stdout.readline())
            config = short_settings({**ready, "time": {"port": 1}}, directory)
            text = config.read_text().replace('kind = "lockstep"\nhost = "127.0.0.1"\nport = 1\n', 'kind = "real"\n')
            config.write_text(text)
            with service(config) as running:
                yield running
        finally:
            simulator.kill()


def idle(running: Service, seconds: float) -> dict[str, float]:
    return {"idle_cpu_percent": cpu_percent(running.process.pid, seconds), "idle_rss_mb": rss_mb(running.process.pid)}


def abort_latency_ms(running: Service) -> float:
    running.start()
    running.until(lambda now: now["state"] == "measuring" and now["step"], "a step; the axes are on their way")
    with running.client() as client, client.stream("GET", "/api/events") as events:
        lines = events.iter_lines()
        while "data" not in next(lines):
            """The status at the beginning."""
        began = time.perf_counter()
        with running.client() as other:
            other.post("/api/abort")
        while '"aborting"' not in next(lines):
            """What still happened before."""
        latency_ms = 1e3 * (time.perf_counter() - began)
    running.reached("aborted")
    running.post("/api/reset")
    return latency_ms


def measured(running: Service, seconds: float) -> dict[str, float]:
    """A run that goes on for a while, then what its journal says of the time between its steps."""
    run_id = running.start()
    running.until(lambda now: now["touches"] > 0, "a touch", FIRST_TOUCH_WITHIN_S)
    share = cpu_percent(running.process.pid, seconds)
    running.post("/api/abort")
    running.reached("aborted")
    with closing(sqlite3.connect(running.state / "journal.sqlite")) as journal:
        rows = journal.execute(
            "SELECT begun, finished FROM steps JOIN runs USING (run) "
            "WHERE run_id = ? AND finished IS NOT NULL ORDER BY ordinal",
            (run_id,),
        ).fetchall()
    gaps = sorted(after[0] - before[1] for before, after in pairwise(rows))
    return {
        "running_cpu_percent": share,
        "peak_rss_mb": rss_mb(running.process.pid, "VmHWM"),
        "steps": len(rows),
        "step_overhead_ms_median": 1e3 * gaps[len(gaps) // 2],
        "step_overhead_ms_p99": 1e3 * gaps[int(0.99 * len(gaps))],
        "overhead_percent": 100.0 * sum(gaps) / (rows[-1][1] - rows[0][0]),
    }


def cpu_percent(process: int, seconds: float) -> float:
    before, began = cpu_s(process), time.perf_counter()
    time.sleep(seconds)
    return 100.0 * (cpu_s(process) - before) / (time.perf_counter() - began)


def cpu_s(process: int) -> float:
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS_PER_S


def rss_mb(process: int, name: str = "VmRSS") -> float:
    lines = dict(line.split(":", 1) for line in Path(f"/proc/{process}/status").read_text().splitlines())
    return int(lines[name].split()[0]) / 1024.0


@contextmanager
def polled(running: Service) -> Iterator[None]:
    """Clients that ask for the status all the time."""
    ended = threading.Event()

    def poll() -> None:
        with running.client() as client:
            while not ended.wait(POLL_EVERY_S):
                client.get("/api/status")

    threads = [threading.Thread(target=poll) for _ in range(POLLING_CLIENTS)]
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        ended.set()
        for thread in threads:
            thread.join()


if __name__ == "__main__":
    main()
