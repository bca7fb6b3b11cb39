"""Trial of every decoder with inputs that are developed from those that reached new branches (atheris, libFuzzer).

    python -m campaigns.fuzz.guided [--inputs 1000000] [--seconds 60] [--seed 1] [--only NAME …] [--folder FOLDER]

Each decoder is tried in a process of its own, with --inputs inputs, but no longer than --seconds. FOLDER keeps the
inputs that reached something new, from which the next call goes on. The last line of the output is JSON and lists what
was raised outside the error tree, what took too long or too much memory; the first such input ends the trial of its
decoder and is kept too. The exit code is 0 only if there was none.
"""

from __future__ import annotations

import argparse
import json
import logging
import multiprocessing
import os
import re
import sys
import warnings
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import TYPE_CHECKING, Any

import atheris
import structlog

if TYPE_CHECKING:
    from campaigns.fuzz.trial import Decoder

OBSERVED = ["agent", "campaigns.fuzz", "drivers", "gcode", "simulators", "twin"]
"""Packages whose branches are observed."""
OWN_SHARE = 0.5
"""Share of mutations that are our own: they know numbers, separators and depth. Those of libFuzzer know bytes."""
INPUT_BOUND_S = 60
MEMORY_MB = 2048
GRACE_S = 600.0
"""Time in s for the last input and the end of a process."""
ERROR = "=== Uncaught Python exception: ==="


@dataclass(frozen=True)
class Extent:
    """Number of inputs of each decoder, its longest duration in s, and the number from which mutations are drawn."""

    inputs: int
    seconds: int
    seed: int


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--inputs", type=int, default=1_000_000, help="inputs of each decoder")
    parser.add_argument("--seconds", type=int, default=60, help="longest duration of each decoder in s")
    parser.add_argument("--seed", type=int, default=1, help="number from which the mutations are drawn")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="names of the decoders; otherwise all")
    parser.add_argument("--folder", type=Path, help="folder of the inputs that are kept")
    factory = "campaigns.fuzz.catalogue:decoders"
    parser.add_argument("--factory", default=factory, help=f"function that yields the decoders, by default {factory}")
    given = parser.parse_args(arguments)
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
    logging.disable(logging.CRITICAL)
    began = perf_counter()
    module, function = given.factory.split(":")
    with atheris.instrument_imports(include=OBSERVED):
        decoders: list[Decoder] = list(getattr(import_module(module), function)())
    if unknown := set(given.only or ()) - {decoder.name for decoder in decoders}:
        parser.error(f"there is no decoder {sorted(unknown)[0]!r}")
    warnings.simplefilter("error")
    extent = Extent(given.inputs, given.seconds, given.seed)
    found: dict[str, dict[str, Any]] = {}
    with ExitStack() as stack:
        folder = given.folder or Path(stack.enter_context(TemporaryDirectory(prefix="volcal-fuzz-")))
        for decoder in decoders:
            if given.only is None or decoder.name in given.only:
                found[decoder.name] = explored(decoder, folder, extent)
                print(f"{decoder.name:36} {json.dumps(found[decoder.name])}", flush=True)
    result = {
        "passed": not any(one["failure"] for one in found.values()),
        "inputs": sum(one["inputs"] for one in found.values()),
        "decoders": found,
        "wall_seconds": round(perf_counter() - began, 1),
    }
    print(json.dumps(result))
    return 0 if result["passed"] else 1


def explored(decoder: Decoder, folder: Path, extent: Extent) -> dict[str, Any]:
    """Try one decoder in a process of its own. Return the number of inputs, that of the branches reached, and the
    failure that ended the trial, empty if there was none."""
    own = folder / re.sub(r"\W+", "-", decoder.name)
    (own / "inputs").mkdir(parents=True, exist_ok=True)
    log = own / "log"
    # A copy of this process: the packages need not be imported and altered once more.
    process = multiprocessing.get_context("fork").Process(target=_explore, args=(decoder, own, log, extent))
    process.start()
    process.join(extent.seconds + GRACE_S)
    hung = process.exitcode is None
    process.kill()
    process.join()
    told = log.read_text(encoding="utf-8", errors="replace")
    failure = "" if process.exitcode == 0 else _failure(told)
    return {
        "inputs": max(map(int, re.findall(r"^(?:#|Done )(\d+)\b", told, re.MULTILINE)), default=0),
        "branches": max(map(int, re.findall(r"cov: (\d+)", told)), default=0),
        "failure": "the process did not end" if hung else failure,
    }


def _explore(decoder: Decoder, folder: Path, log: Path, extent: Extent) -> None:
    with log.open("wb") as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
    inputs = folder / "inputs"
    for number, seed in enumerate(decoder.seeds):
        decoder.decode(seed)
        (inputs / f"seed-{number}").write_bytes(seed)
    limits = [f"-atheris_runs={round(decoder.share * extent.inputs)}", f"-max_total_time={extent.seconds}"]
    limits += [f"-timeout={INPUT_BOUND_S}", f"-rss_limit_mb={MEMORY_MB}"]
    options = [*limits, f"-seed={extent.seed}", f"-artifact_prefix={folder}/", "-print_final_stats=1"]
    atheris.Setup([sys.argv[0], *options, str(inputs)], _judging(decoder), custom_mutator=_mutating())
    atheris.Fuzz()  # ends the process


def _judging(decoder: Decoder) -> Callable[[bytes], None]:
    def judge(data: bytes) -> None:
        try:
            decoder.decode(data)
        except decoder.allowed:
            return

    return judge


def _mutating() -> Callable[[bytes, int, int], bytes]:
    mutated = import_module("campaigns.fuzz.mutation").mutated  # after the packages that are observed

    def mutate(data: bytes, longest: int, seed: int) -> bytes:
        random = Random(seed)  # noqa: S311  no secret
        if random.random() < OWN_SHARE:
            return bytes(mutated(random, data)[:longest])
        return bytes(atheris.Mutate(data, longest))

    return mutate


def _failure(told: str) -> str:
    """Return what the process said from the error on, or else its last words."""
    at = told.find(ERROR)
    return told[at : at + 2000] if at >= 0 else told[-2000:]


if __name__ == "__main__":
    sys.exit(main())
