"""Conversion of a compensation table to bytes and back, with a CRC-32 and a division into blocks for the transfer."""

from __future__ import annotations

import zlib
from collections.abc import Iterator

import numpy as np

from drivers.modbus_cnc.registers import TableDescriptor
from drivers.roles import TableImage

BLOCK_BYTES = 240
"""Size of a data block: 120 registers hold 60 counts, that is 20 nodes."""


def table_bytes(table: TableImage) -> bytes:
    """Return all counts (integer corrections) of a table as big-endian int32. The node index varies fastest along z and
    slowest along x.

    Each node has its counts in the order dx, dy, dz (docs/reference/modbus-register-map.md, section 8).
    """
    return table.counts.astype(">i4").tobytes(order="C")


def crc32(data: bytes) -> int:
    return zlib.crc32(data)


def block_count(nodes: tuple[int, int, int]) -> int:
    nx, ny, nz = nodes
    # Three corrections of 4 bytes at each node; -(-a // b) rounds up.
    return -(-nx * ny * nz * 12 // BLOCK_BYTES)


def data_blocks(data: bytes) -> Iterator[bytes]:
    """Yield `data`, the bytes of a table, in blocks of `BLOCK_BYTES` bytes. The last block is padded with zeros."""
    for start in range(0, len(data), BLOCK_BYTES):
        yield data[start : start + BLOCK_BYTES].ljust(BLOCK_BYTES, b"\x00")


def table_descriptor(bank: int, table: TableImage, crc: int) -> TableDescriptor:
    return TableDescriptor(bank, table.shape, table.origin_mm, table.step_mm, table.resolution_mm, crc)


def decode_table(descriptor: TableDescriptor, data: bytes) -> TableImage:
    """Return the table with the grid of `descriptor` and the counts in `data`, which holds 12 bytes per node."""
    counts = np.frombuffer(data, dtype=">i4").astype(np.int32).reshape(*descriptor.nodes, 3)
    return TableImage(descriptor.origin, descriptor.step, descriptor.resolution, counts)
