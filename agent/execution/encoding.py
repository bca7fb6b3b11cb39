"""Conversion of the steps of a run and their results to JSON for the journal, the database that records them, and back.

Floats are not rounded: each float is read back with exactly the value that was written.
"""

from __future__ import annotations

import json
import zlib
from dataclasses import dataclass, fields
from enum import Enum
from functools import cache
from typing import Any

import numpy as np

from agent.execution.steps import OrientTo, ReadPosition, Step, TouchTowards
from agent.execution.stored_json import stored_json
from drivers.roles import Miss, Orientation, TableImage, Touch


@dataclass(frozen=True)
class LostPlacement:
    """Result of a step that was not carried out, because an artefact that was placed by hand no longer stood where it
    had been measured. A resumed run that finds this result raises PlacementLost with the same reason."""

    reason: str


def encode_step(step: Step) -> str:
    """Return the fields of the step, except its key and the functions that it contains, as JSON text."""
    kind: type = type(step)
    values = [(name, getattr(step, name)) for name in _field_names(kind)]
    return to_json({name: value for name, value in values if not callable(value)})


@cache
def _field_names(kind: type) -> tuple[str, ...]:
    """Return the names of the fields of a class of steps, except its key."""
    return tuple(f.name for f in fields(kind) if f.name != "key")


def encode_result(result: object) -> str | None:
    return None if result is None else to_json(result)


def decode_result(kind: str, text: str | None) -> Any:
    """Return the result of a step from the JSON text that `encode_result` wrote.

    `kind` is the name of the step's class. If the result was a compensation table, only its shape and its CRC-32
    checksum were written, and the mapping ``{"shape": …, "crc32": …}`` is returned.
    """
    value: Any = None if text is None else stored_json(text)
    if isinstance(value, dict) and value.keys() == {"placement_lost"}:
        return LostPlacement(value["placement_lost"])
    if kind == TouchTowards.__name__:
        return Touch(_triple(value["touch"])) if "touch" in value else Miss(_triple(value["miss"]))
    if kind == OrientTo.__name__:
        return Orientation(**value)
    return _triple(value) if kind == ReadPosition.__name__ else value


def to_json(value: object) -> str:
    return _ENCODER.encode(value)


def table_digest(table: TableImage) -> int:
    """Return the CRC-32 checksum of the corrections of a compensation table. It is computed from the bytes as they are
    sent to the controller.

    The corrections are big-endian 32-bit integers. The grid nodes are ordered with the index along X varying slowest;
    the corrections dx, dy and dz of a node follow one another.
    """
    return zlib.crc32(table.counts.astype(">i4").tobytes())


def is_same_table(one: TableImage | None, other: TableImage | None) -> bool:
    """Return True if two banks contain the same corrections at the same places, or if both are empty.

    Equal checksums do not suffice: `table_digest` contains neither the grid nor the resolution of a table.
    """
    return one is other if one is None or other is None else one.same_as(other)


def decode_table(origin_mm: str, step_mm: str, resolution_mm: float, shape: str, counts: bytes) -> TableImage:
    """Return the compensation table that is stored in one row of the journal's database table `tables`. The arguments
    are columns of this row.
    """
    values = np.frombuffer(counts, ">i4").astype(np.int32).reshape(*stored_json(shape), 3)
    return TableImage(_triple(stored_json(origin_mm)), _triple(stored_json(step_mm)), resolution_mm, values)


def _triple(values: list[float]) -> tuple[float, float, float]:
    x, y, z = values
    return x, y, z


def _plain(value: object) -> Any:  # noqa: PLR0911  one line a type
    match value:
        case Touch():
            return {"touch": list(value.position_mm)}
        case Miss():
            return {"miss": list(value.position_mm)}
        case Orientation():
            return {"azimuth_deg": value.azimuth_deg, "elevation_deg": value.elevation_deg}
        case LostPlacement():
            return {"placement_lost": value.reason}
        case TableImage():
            return {"shape": value.shape, "crc32": table_digest(value)}
        case np.ndarray():
            return value.tolist()
        case np.generic():
            return value.item()
        case Enum():
            return value.value
        case tuple():
            return list(value)
    if hasattr(value, "__dataclass_fields__"):
        return {name: getattr(value, name) for name in value.__dataclass_fields__}
    if hasattr(value, "items"):
        return dict(value.items())
    raise TypeError(f"{type(value).__name__} cannot be written to the journal")


_ENCODER = json.JSONEncoder(default=_plain, separators=(",", ":"), allow_nan=False)
"""Encoder of all texts: `json.dumps` would make one for each text, which takes as long as to encode a step."""
