"""Performance figures of the calibration service at real speed, as one line of JSON.

The figures are the time from an abort request to the stop command, the overhead per step, and the CPU share and memory
of the service.

`volcal serve` and `volcal simulate` run as separate processes on the wall clock. Four clients poll the status, and one
client receives the events. The instant of an abort request is taken before its connection is made. The instant of the
stop command is taken when the command STOP passes between agent and controller. The overhead of a step is the time from
the result of the previous step to the start of the step. The overhead is evaluated only for steps with an effect on the
machine, and not for readings, because the device itself takes time for a reading.
"""

from __future__ import annotations

import argparse
import json
import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "system"))
from service_process import Service, service, short_settings
from simulated import COMMAND, SCENARIO, wait_for

from agent.execution.journal import Journal
from agent.execution.journal_reader import open_journal
from agent.execution.steps import STEPS_WITH_EFFECT
from benchmarks.service_wire import RecordingProxy, recording_proxy

TICKS_PER_S = os.sysconf("SC_CLK_TCK")
POLLING_CLIENTS = 4
POLL_EVERY_S = 0.05
COMMITS = 400
POLLED_WITHIN_S = 45.0
FIRST_TOUCH_WITHIN_S = 300.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--aborts", type=int, default=20, help="number of aborts")
    parser.add_argument(
        "--seconds", type=float, default=30.0, help="duration of the idle phase and of the measured run, in s"
    )
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, real_speed(Path(folder)) as (running, between):
        figures = idle(running, chosen.seconds)
        with polling_clients(running):
            stops = sorted(abort_to_stop_ms(running, between) for _ in range(chosen.aborts))
            early = sorted(early_abort_ms(running) for _ in range(max(chosen.aborts // 4, 1)))
        figures |= {"abort_to_stop_ms_median": stops[len(stops) // 2], "abort_to_stop_ms_worst": stops[-1]}
        figures |= {"aborts": len(stops), "abort_in_preflight_ms_worst": early[-1]}
        figures |= measure_run(running, chosen.seconds)
    print(json.dumps({name: round(value, 3) for name, value in figures.items()}))


@contextmanager
def real_speed(directory: Path) -> Iterator[tuple[Service, RecordingProxy]]:
    arguments = ["--can", "socketcand:127.0.0.1:0", "--clock", "real", "--end-with-stdin"]
    command = [*COMMAND, "simulate", "--config", str(SCENARIO), *arguments]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as simulator:  # noqa: S603
        try:
            assert simulator.stdout is not None
            ready = json.loads(simulator.stdout.readline())
            with (
                recording_proxy(ready["modbus"]["host"], ready["modbus"]["port"]) as between,
                service(_settings(ready, between, directory)) as running,
            ):
                yield running, between
        finally:
            simulator.kill()


def _settings(ready: dict[str, Any], between: RecordingProxy, directory: Path) -> Path:
    config = short_settings({**ready, "time": {"port": 1}, "modbus": {"port": between.port}}, directory)
    text = config.read_text().replace('kind = "lockstep"\nhost = "127.0.0.1"\nport = 1\n', 'kind = "real"\n')
    config.write_text(text)
    return config


def idle(running: Service, seconds: float) -> dict[str, float]:
    return {"idle_cpu_percent": cpu_percent(running.process.pid, seconds), "idle_rss_mb": rss_mb(running.process.pid)}


def abort_to_stop_ms(running: Service, between: RecordingProxy) -> float:
    """Return the time in ms from an abort request during a touch or a move until the command STOP passes on its way to
    the controller.
    """
    running.start()
    running.until(lambda now: now["state"] == "measuring" and now["step"], "a step; the axes are on their way")
    known = len(between.stops)
    began = ask_abort(running)
    wait_for(lambda: len(between.stops) > known, "STOP on the wire")
    latency_ms = 1e3 * (between.stops[known] - began)
    running.reached("aborted")
    running.post("/api/reset")
    return latency_ms


def early_abort_ms(running: Service) -> float:
    """Return the time in ms from an abort request during the preflight (simulated execution of the plan) until the
    service's state shows the abort.
    """
    running.start()
    running.until(lambda now: now["state"] == "preflight", "the preflight")
    began = ask_abort(running)
    running.reached("aborting", "aborted")
    latency_ms = 1e3 * (time.perf_counter() - began)
    running.reached("aborted")
    running.post("/api/reset")
    return latency_ms


def ask_abort(running: Service) -> float:
    """Send an abort request and return the instant before its connection was made.

    The function uses a plain socket, because an HTTP client would add the time of its own preparations.
    """
    host, _, port = running.url.removeprefix("http://").partition(":")
    request = f"POST /api/abort HTTP/1.1\r\nHost: {host}\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
    began = time.perf_counter()
    with socket.create_connection((host, int(port)), timeout=POLLED_WITHIN_S) as link:
        link.sendall(request.encode())
        assert link.recv(12) == b"HTTP/1.1 200"
    return began


def measure_run(running: Service, seconds: float) -> dict[str, float]:
    """Start a run in the service, observe it for `seconds` s, abort it, and return its figures.

    The figures are the times between the steps of the run, taken from its journal, and the CPU share and the memory of
    the service.
    """
    run_id = running.start()
    running.until(lambda now: now["touches"] > 0, "a touch", FIRST_TOUCH_WITHIN_S)
    commits = sorted(bare_commits_s(running.directory, COMMITS))
    share = cpu_percent(running.process.pid, seconds)
    running.post("/api/abort")
    running.reached("aborted")
    with open_journal(running.state) as reader:
        steps = reader.steps(reader.require_run(run_id).run, procedure_only=True)
    rows = [(step.begun_s, step.finished_s, step.kind) for step in steps if step.finished_s is not None]
    moving = {kind.__name__ for kind in STEPS_WITH_EFFECT}
    gaps = sorted(after[0] - before[1] for before, after in pairwise(rows) if after[2] in moving)
    return {
        "bare_commit_ms_median": 1e3 * commits[len(commits) // 2],
        "bare_commit_ms_p99": 1e3 * commits[int(0.99 * len(commits))],
        "running_cpu_percent": share,
        "peak_rss_mb": rss_mb(running.process.pid, "VmHWM"),
        "steps": len(gaps),
        "step_overhead_ms_median": 1e3 * gaps[len(gaps) // 2],
        "step_overhead_ms_p99": 1e3 * gaps[int(0.99 * len(gaps))],
        "overhead_percent": 100.0 * sum(gaps) / (rows[-1][1] - rows[0][0]),
    }


def bare_commits_s(directory: Path, count: int) -> Iterator[float]:
    """Yield the times in s of `count` minimal durable database commits that are made on the disk of `directory` during
    a run.

    These times are the lower limit of the overhead of a step of the run.
    """
    journal = Journal(directory / "bare")
    connection = journal._connection
    connection.execute("CREATE TABLE bare (n INTEGER PRIMARY KEY, t TEXT)")
    for number in range(count):
        began = time.perf_counter()
        connection.execute("INSERT INTO bare VALUES (?, ?)", (number, "x" * 120))
        yield time.perf_counter() - began
        time.sleep(0.05)
    journal.close()


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
def polling_clients(running: Service) -> Iterator[None]:
    """Run clients that poll the status of the service while the context is active.

    One further client receives the events of the service.
    """
    ended = threading.Event()

    def poll() -> None:
        with running.client() as client:
            while not ended.wait(POLL_EVERY_S):
                client.get("/api/status")

    def hear() -> None:
        with running.client() as client, client.stream("GET", "/api/events") as events:
            for _ in events.iter_lines():
                if ended.is_set():
                    return

    threads = [threading.Thread(target=poll) for _ in range(POLLING_CLIENTS)]
    threads.append(threading.Thread(target=hear, daemon=True))
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        ended.set()
        for thread in threads[:POLLING_CLIENTS]:
            thread.join()


if __name__ == "__main__":
    main()
