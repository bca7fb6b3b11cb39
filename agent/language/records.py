"""Entries of journal records in words, in both languages. An entry without words is for programs alone, and shown to
nobody."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Any, Final

_MOST_DECIMALS: Final = 3

WORDS: Final = MappingProxyType(
    {
        "drift_um": ("displacement of the first ball {value} µm", "Verschiebung der ersten Kugel {value} µm"),
        "limit_um": ("limit {value} µm", "Grenze {value} µm"),
        "figure_um": ("measured {value} µm", "gemessen {value} µm"),
        "off_mm": ("{value} mm from the expected place", "{value} mm neben dem erwarteten Ort"),
        "off_um": ("{value} µm from the former place", "{value} µm neben dem vorherigen Ort"),
        "centre_mm": ("centre at {value} mm", "Mittelpunkt bei {value} mm"),
        "form_um": ("form deviation {value} µm", "Formabweichung {value} µm"),
        "shift_mm": ("shifted by {value} mm", "verschoben um {value} mm"),
        "turn_deg": ("turned by {value}°", "verdreht um {value}°"),
        "reachable_balls": ("{value} balls within reach", "{value} erreichbare Kugeln"),
        "readings_not_used": ("{value} readings not used", "{value} Anzeigen nicht verwendet"),
        "deadline_minutes": ("time limit {value} min", "Zeitgrenze {value} min"),
        "position": ("position {value}", "Position {value}"),
        "bank": ("bank {value}", "Bank {value}"),
        "device": ("device {value}", "Gerät {value}"),
        "interruptions": ("{value} interruptions so far", "bisher {value} Unterbrechungen"),
    }
)
"""Words for a value with its unit, by the name of the entry: English and German. Of a vector in `LENGTHS` the length is
told, of another one its components."""
SENTENCES: Final = ("text", "note", "reason", "error", "then")
"""Entries that are sentences, in the order in which they are told."""
LENGTHS: Final = ("drift_um", "off_mm")


def record_words() -> dict[str, dict[str, str]]:
    """Return the words as a catalogue of the page, with keys such as `record.drift_um`."""
    return {f"record.{name}": {"en": english, "de": german} for name, (english, german) in WORDS.items()}


def record_in_words(record: Mapping[str, Any]) -> str:
    """Return the entries of a journal record in English words with units, without those that are for programs alone."""
    return "; ".join(_parts(record))


def _parts(record: Mapping[str, Any]) -> Iterator[str]:
    yield from (str(record[name]) for name in SENTENCES if record.get(name))
    for name, value in record.items():
        if name in WORDS and value not in ("", None):
            yield WORDS[name][0].format(value=_figure(name, value))


def _figure(name: str, value: Any) -> str:
    if isinstance(value, (list, tuple)):
        return _number(math.hypot(*value)) if name in LENGTHS else " / ".join(map(_number, value))
    return _number(value) if isinstance(value, (int, float)) else str(value)


def _number(value: float) -> str:
    """Return a number with at most three decimals, without zeros at its end."""
    return f"{value:.{_MOST_DECIMALS}f}".rstrip("0").rstrip(".") if isinstance(value, float) else str(value)
