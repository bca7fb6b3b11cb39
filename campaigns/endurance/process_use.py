"""Use of memory, handles, threads and disk by a process and its files, read from the operating system."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import psutil

from twin.arrays import Array

MB = 1e6


@dataclass(frozen=True)
class Use:
    """Memory in MB, file handles, threads and CPU time in s of a process, and the disk space in MB of its files."""

    memory_mb: float
    handles: int
    threads: int
    cpu_s: float
    disk_mb: float

    @classmethod
    def of(cls, pid: int, directory: Path) -> Use:
        """Return what the process `pid` uses now. Its files are those below `directory`."""
        process = psutil.Process(pid)
        with process.oneshot():
            times = process.cpu_times()
            memory, threads, handles = process.memory_info().rss, process.num_threads(), process.num_fds()
        files = [path.stat().st_size for path in directory.rglob("*") if path.is_file()]
        return cls(memory / MB, handles, threads, times.user + times.system, sum(files) / MB)


def growth_per_run(values: Array, period: int) -> float:
    """Return the slope of the last half of `values` (N,) per run, as the median of the slopes of pairs (Theil 1950): a
    single large value, such as a report that is being drawn, does not matter.

    The kinds of runs recur after `period` runs, and with them the values, which a calibration leaves lower than
    verifications. Runs are therefore compared with those of the same kind; with all, if there are fewer than two
    periods.
    """
    last = values[len(values) // 2 :]
    step = period if len(last) >= 2 * period else 1
    slopes = [(last[j] - last[i]) / (j - i) for i in range(len(last)) for j in range(i + step, len(last), step)]
    return float(sorted(slopes)[len(slopes) // 2]) if slopes else 0.0
