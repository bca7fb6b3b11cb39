"""Results of an earlier identification from files, which a new one into the same folder replaces."""

from __future__ import annotations

import re
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

IDENTIFY = "identify-"
"""Begin of the identity of an identification from files."""
ESTIMATE_FILE = "estimate.json"
_ORIGIN_BYTES = 4096  # the origin stands at the begin of an estimate file
_BY_IDENTIFY = re.compile(rb'"run_id":\s*"' + IDENTIFY.encode())


def replaced_results(folder: Path, names: Iterable[str], inputs: Iterable[Path]) -> tuple[str, ...]:
    """Return those of the files `names` in `folder` that an earlier identification from files has written.

    If the estimate beside them is that of a run on a machine, or if there is none, they are the user's: none is
    returned. Nor are the files that the new identification reads, `inputs`, and those whose names begin like that of
    such a file: an artefact file reads a file with its covariance.
    """
    origin = b""
    with suppress(OSError), (folder / ESTIMATE_FILE).open("rb") as file:
        origin = file.read(_ORIGIN_BYTES)
    if _BY_IDENTIFY.search(origin) is None:
        return ()
    read = {path.stem for path in inputs if path.resolve().parent == folder.resolve()}
    return tuple(name for name in names if not any(name.startswith(stem) for stem in read))
