"""Time and memory needed to correct a part program of a million lines.

The memory is compared with the memory for a part program that is shorter by a factor of 100. The time is compared with
that of a simple correction program, which corrects one line after another and looks up the compensation table for every
line. The simple program is timed on a sample, and the times per line are compared. The output ends with one line of
JSON.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import resource
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from time import perf_counter, process_time

import numpy as np

from gcode.correction import correct_program
from gcode.setup import CorrectionOptions, PartSetup
from twin.compensation.table import CompensationTable, regular_nodes
from twin.machine.anchor import Anchor

SETUP = PartSetup({"G54": (500.0, 300.0, 200.0)})
OPTIONS = CorrectionOptions(max_chord_error_mm=0.002)
LINES = 1_000_000
SAMPLE = 20_000


def table() -> CompensationTable:
    """Return a smooth compensation table with corrections of some tens of µm and a node spacing that is typical of
    controllers.
    """
    nodes = regular_nodes(((0.0, 4000.0), (0.0, 1300.0), (0.0, 1500.0)), (100.0, 100.0, 100.0))
    x, y, z = np.meshgrid(*nodes, indexing="ij")
    waves = (np.sin(x / 900.0 + y / 700.0), np.cos(y / 500.0 - z / 800.0), np.sin(z / 600.0 + x / 1500.0))
    corrections = 0.02 * np.stack(waves, axis=-1)
    return CompensationTable(*nodes, corrections, np.zeros(3), Anchor(np.zeros(3)), np.zeros(x.shape, dtype=bool))


def program(lines: int) -> Iterator[str]:
    """Yield the lines of a part program with finishing passes over a wavy face.

    Most lines are short straight moves; arcs and rapid moves occur occasionally.
    """
    yield "G21 G90 G17 G54\nG0 X0 Y0 Z0\n"
    for number in range(lines):
        x, y = 0.8 * (number % 2000), 0.002 * number % 700.0
        if number % 500 == 499:
            yield f"G3 X{x:.3f} Y{y + 1.0:.3f} R20 F900\n"
        elif number % 2000 == 0:
            yield f"G0 X{x:.3f} Y{y:.3f} Z50\n"
        else:
            yield f"G1 X{x:.3f} Y{y:.3f} Z{20.0 * math.sin(0.01 * x):.4f} F2400\n"


def from_file_to_file(lines: int) -> tuple[float, float, int, float]:
    """Correct a part program of `lines` lines from file to file, and return four figures.

    These are the wall time in s, the CPU time in s, the number of lines written, and the peak resident memory of the
    process in MB.
    """
    with tempfile.TemporaryDirectory() as folder:
        part, out = Path(folder) / "part.nc", Path(folder) / "out.nc"
        with part.open("w") as file:
            file.writelines(program(lines))
        start, busy = perf_counter(), process_time()
        with part.open() as source, out.open("w") as target:
            counts = correct_program(source, table(), SETUP, OPTIONS, target.write, name="benchmark")
        seconds, busy = perf_counter() - start, process_time() - busy
    return seconds, busy, counts.written_lines, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def in_own_process(lines: int) -> tuple[float, float, int, float]:
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(from_file_to_file, (lines,))


def one_by_one(lines: Iterable[str], field: CompensationTable) -> float:
    """Return the CPU time in s that a simple program needs to correct `lines`, the lines of a part program, one after
    another.

    For every line the simple program splits the words, interpolates the correction of one point in the table `field`,
    and formats the words again.
    """
    here, work = {"X": 0.0, "Y": 0.0, "Z": 0.0}, SETUP.work_offsets["G54"]
    start = process_time()
    for line in lines:
        words = line.split()
        for word in words:
            if word[0] in here:
                here[word[0]] = float(word[1:])
        point = np.array([[value + zero for value, zero in zip(here.values(), work, strict=True)]])
        moved = point + field.at(point) - work
        " ".join(f"{letter}{value:.4f}" for letter, value in zip("XYZ", moved[0], strict=True))
    return process_time() - start


def run(lines: int = LINES) -> dict[str, float]:
    field = table()
    seconds, busy, written, peak = in_own_process(lines)
    _, _, _, peak_small = in_own_process(max(lines // 100, 1))
    sample = [line for text in program(SAMPLE) for line in text.splitlines()]
    slow = one_by_one(sample, field)
    return {
        "lines": lines,
        "seconds": round(seconds, 2),
        "busy_seconds": round(busy, 2),
        "busy_us_per_line": round(1e6 * busy / lines, 2),
        "lines_written": written,
        "peak_mb": round(peak, 1),
        "peak_mb_of_a_hundredth": round(peak_small, 1),
        "one_by_one_busy_us_per_line": round(1e6 * slow / len(sample), 2),
        "one_by_one_over_ours": round(slow / len(sample) / (busy / lines), 2),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--lines", type=int, default=LINES)
    print(json.dumps(run(parser.parse_args().lines)))


if __name__ == "__main__":
    main()
