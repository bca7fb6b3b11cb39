"""Decoder of estimate files, and how a good one is made short enough to be read a million times."""

from __future__ import annotations

import json
from itertools import accumulate
from typing import Any

from agent.files import read_text
from campaigns.fuzz.memory_file import MemoryFile
from campaigns.fuzz.trial import Decoder
from twin.formats.estimate_file import parse_estimate

_CANDIDATES = 3


def estimate_decoder(text: str) -> Decoder:
    """Return the decoder of estimate files; `text` is a good one, and short."""
    file = MemoryFile()
    return Decoder(
        "estimate (JSON)",
        [text.encode()],
        lambda data: parse_estimate(read_text(file.holding(data)), "estimate.json"),
    )


def short_estimate(text: str) -> str:
    """Return the estimate file `text` with one misfit mode of each kind, made of a few candidate fields. All sections
    remain; what is left out are columns of long matrices, whose numbers are all read alike."""
    document = json.loads(text)
    carried = document["carried_over"]
    misfit = carried["misfit"]
    sizes = misfit["sizes"]
    chosen = [first for first, size in zip(accumulate(sizes, initial=0), sizes, strict=False) if size]
    before = len(carried["mean"]) - sum(sizes)  # in a stored estimate the modes are the last unknowns
    kept = [*range(before), *(before + mode for mode in chosen)]
    misfit["sizes"] = [min(size, 1) for size in sizes]
    misfit["degrees"] = misfit["degrees"][:_CANDIDATES]
    misfit["mixing"] = [_columns(fields[:_CANDIDATES], chosen) for fields in misfit["mixing"]]
    misfit["removed"], misfit["rigid"] = _columns(misfit["removed"], chosen), _columns(misfit["rigid"], chosen)
    carried["mean"] = [carried["mean"][unknown] for unknown in kept]
    triangle = carried["covariance"]
    carried["covariance"] = [[triangle[row][column] for column in kept[: at + 1]] for at, row in enumerate(kept)]
    return json.dumps(document)


def _columns(rows: list[list[Any]], chosen: list[int]) -> list[list[Any]]:
    return [[row[column] for column in chosen] for row in rows]
