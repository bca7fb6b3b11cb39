r"""Text format of a compensation table.

Two checksums reveal a file that was truncated, changed, or put together from parts of different tables.

::

    volcal-compensation-table 1
    origin_mm X Y Z
    step_mm X Y Z
    resolution_mm R
    nodes NX NY NZ
    counts_crc32 HHHHHHHH      over the counts as big-endian int32
    DX DY DZ                   one line per node, x slowest, z fastest
    file_crc32 HHHHHHHH        over every byte before this line

Numbers are written to full float64 precision. Other parts of volcal identify a table by the CRC-32 of its counts.
"""

from __future__ import annotations

import io
import math
import re
import zlib

import numpy as np
from numpy.typing import NDArray

from drivers.errors import ChecksumMismatch, StoreError
from drivers.roles import TableImage

HEADER = re.compile(
    r"volcal-compensation-table 1\n"
    r"origin_mm (?P<origin>\S+ \S+ \S+)\nstep_mm (?P<step>\S+ \S+ \S+)\nresolution_mm (?P<resolution>\S+)\n"
    r"nodes (?P<nodes>\d{1,6} \d{1,6} \d{1,6})\ncounts_crc32 (?P<crc>[0-9A-F]{8})\n"
)
TRAILER = re.compile(r"file_crc32 ([0-9A-F]{8})\n\Z")


def counts_crc32(counts: NDArray[np.int32]) -> int:
    """Return the CRC-32 of the counts of a compensation table, taken as big-endian int32.

    The node index varies slowest along x; each node has its counts in the order dx, dy, dz.
    """
    return zlib.crc32(counts.astype(">i4").tobytes(order="C"))


def format_table(table: TableImage) -> str:
    rows = io.StringIO()
    np.savetxt(rows, table.counts.reshape(-1, 3), fmt="%d")
    head = (
        "volcal-compensation-table 1\n"
        f"origin_mm {_numbers(table.origin_mm)}\n"
        f"step_mm {_numbers(table.step_mm)}\n"
        f"resolution_mm {float(table.resolution_mm)!r}\n"
        f"nodes {' '.join(map(str, table.shape))}\n"
        f"counts_crc32 {counts_crc32(table.counts):08X}\n"
    )
    body = head + rows.getvalue()
    return f"{body}file_crc32 {zlib.crc32(body.encode('ascii')):08X}\n"


def parse_table(text: str, **where: str | int) -> TableImage:
    """Parse the text of a table file. The origin of the text, given as `where`, is added to every error.

    Raises StoreError if the text is not a table, and ChecksumMismatch if the table was changed.
    """
    last = TRAILER.search(text)
    if last is None:
        raise StoreError(
            "table file does not end with its checksum line: it is truncated or not a table", hint=RESTAGE_HINT, **where
        )
    body = text[: last.start()]
    # Bytes that are not ASCII were read as surrogates; encoding gives the original bytes back, and the CRC differs.
    if zlib.crc32(body.encode("utf-8", "surrogateescape")) != int(last[1], 16):
        raise ChecksumMismatch("table file was changed after it was written", hint=RESTAGE_HINT, **where)
    head = HEADER.match(body)
    if head is None:
        raise StoreError("table file has no header of version 1", hint=RESTAGE_HINT, **where)
    try:
        return _image(head, body[head.end() :])
    except ValueError as error:
        raise StoreError("table file is inconsistent", hint=RESTAGE_HINT, **where) from error


RESTAGE_HINT = "stage the table again"


def _image(head: re.Match[str], rows: str) -> TableImage:
    nodes = [int(word) for word in head["nodes"].split()]
    # Read with 64 bits first, so that a number that does not fit 32 bits is found and does not wrap.
    wide = np.array(rows.split(), dtype=np.int64)
    if wide.size != 3 * math.prod(nodes) or rows.count("\n") != math.prod(nodes):
        raise ValueError(f"{rows.count(chr(10))} rows of counts for {nodes} nodes")
    if np.any(wide != wide.astype(np.int32)):
        raise ValueError("a count does not fit 32 bits")
    counts = wide.astype(np.int32).reshape(*nodes, 3)
    if counts_crc32(counts) != int(head["crc"], 16):
        raise ValueError("CRC-32 of the counts differs from the one stated")
    return TableImage(_triple(head["origin"]), _triple(head["step"]), float(head["resolution"]), counts)


def _numbers(values: tuple[float, float, float]) -> str:
    return " ".join(repr(float(value)) for value in values)


def _triple(text: str) -> tuple[float, float, float]:
    x, y, z = (float(word) for word in text.split())
    return x, y, z
