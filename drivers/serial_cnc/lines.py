"""Parsing of the lines that a GRBL controller sends. The class of a line depends only on its text.

Source: gnea/grbl, doc/markdown/interface.md ("Message Summary").
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

Triple = tuple[float, float, float]


class GarbledLineError(ValueError):
    """Error for a line that belongs to no known class of GRBL lines, or that has contents not allowed in its class."""


@dataclass(frozen=True)
class AnswerLine:
    """Answer ``ok`` or ``error:n``. The controller sends exactly one such answer for each line that it receives."""

    error: int | None


@dataclass(frozen=True)
class StatusReport:
    """Status report, which is the answer to ``?``. `fields` maps field names to texts, as in ``{"FS": "500,0"}``."""

    state: str
    substate: int | None
    fields: Mapping[str, str]

    def triple(self, name: str) -> Triple | None:
        """Return the three coordinates in the field `name`, or None if the field is absent.

        Raises GarbledLineError if the field has other contents.
        """
        return _triple(self.fields[name]) if name in self.fields else None

    def pair(self, name: str) -> tuple[float, float] | None:
        """Return the first two numbers in the field `name`, or None if the field is absent.

        Raises GarbledLineError if the field has fewer than two numbers.
        """
        if name not in self.fields:
            return None
        values = _numbers(self.fields[name])
        if len(values) < 2:
            raise GarbledLineError(f"not two numbers: {name}:{self.fields[name]}")
        return values[0], values[1]


@dataclass(frozen=True)
class AlarmLine:
    code: int


@dataclass(frozen=True)
class ProbeResult:
    """Probe result ``[PRB:x,y,z:1]`` with the position in machine coordinates."""

    position: Triple
    tripped: bool


@dataclass(frozen=True)
class MessageLine:
    """Line in brackets that is not a probe result: ``[MSG:...]``, ``[GC:...]``, ``[G54:...]``, ``[VER:...]``."""

    kind: str
    text: str

    def triple(self) -> Triple:
        return _triple(self.text)

    def number(self) -> float:
        return _numbers(self.text)[0]


@dataclass(frozen=True)
class SettingLine:
    """Line that gives one setting in the form ``$number=text``."""

    number: int
    text: str


@dataclass(frozen=True)
class WelcomeLine:
    """Line sent by the controller after a restart."""

    text: str


@dataclass(frozen=True)
class StartupLine:
    """Line about a startup block that the controller executed after a restart. It contains the block and its answer."""

    text: str


Line = AnswerLine | StatusReport | AlarmLine | ProbeResult | MessageLine | SettingLine | WelcomeLine | StartupLine

_ERROR: Final = re.compile(r"error:(\d{1,3})")
_ALARM: Final = re.compile(r"ALARM:(\d{1,3})")
_SETTING: Final = re.compile(r"\$(N?\d{1,9})=(.*)")
_WELCOME: Final = re.compile(r"Grbl(HAL)? \d.*\[.*\]")
_PROBE: Final = re.compile(r"([-\d.,]+):([01])")
_STATE: Final = re.compile(r"(Idle|Run|Hold|Jog|Alarm|Door|Check|Home|Sleep|Tool)(?::(\d{1,9}))?")


def parse_line(raw: bytes) -> Line:  # noqa: PLR0911  one line a class
    """Parse one line into an object of its class. Raises GarbledLineError if the line belongs to no class."""
    try:
        text = raw.decode("ascii")
    except UnicodeDecodeError:
        raise GarbledLineError(f"not ASCII: {raw!r}") from None
    if text == "ok":
        return AnswerLine(None)
    if match := _ERROR.fullmatch(text):
        return AnswerLine(int(match[1]))
    if text.startswith("<") and text.endswith(">"):
        return _status(text)
    if match := _ALARM.fullmatch(text):
        return AlarmLine(int(match[1]))
    if text.startswith("[") and text.endswith("]"):
        return _bracketed(text[1:-1])
    if match := _SETTING.fullmatch(text):
        # GRBL builds for terminals append a description of the setting: "$100=250.000 (x, step/mm)".
        name, value = match[1], match[2].split(" (", 1)[0].strip()
        return StartupLine(text) if name.startswith("N") else SettingLine(int(name), value)
    if _WELCOME.fullmatch(text):
        return WelcomeLine(text)
    if text.startswith(">"):
        return StartupLine(text)
    raise GarbledLineError(f"a line of no known kind: {text!r}")


def _status(text: str) -> StatusReport:
    state, *rest = text[1:-1].split("|")
    match = _STATE.fullmatch(state)
    if match is None:
        raise GarbledLineError(f"unknown state in {text!r}")
    fields: dict[str, str] = {}
    for field in rest:
        name, separator, value = field.partition(":")
        if not separator or name in fields:
            raise GarbledLineError(f"malformed status report {text!r}")
        fields[name] = value
    # GRBL reports machine or work coordinates, as set by $10; a report without either is garbled.
    report = StatusReport(match[1], int(match[2]) if match[2] else None, fields)
    if report.triple("MPos") is None and report.triple("WPos") is None:
        raise GarbledLineError(f"status report without a position: {text!r}")
    # Read once here, so that garbled fields are found in the line that contains them.
    report.triple("WCO")
    report.pair("FS")
    report.pair("Ov")
    return report


def _bracketed(text: str) -> ProbeResult | MessageLine:
    kind, separator, rest = text.partition(":")
    if not separator:
        raise GarbledLineError(f"malformed message [{text}]")
    if kind != "PRB":
        return MessageLine(kind, rest)
    match = _PROBE.fullmatch(rest)
    if match is None:
        raise GarbledLineError(f"malformed probe result [{text}]")
    return ProbeResult(_triple(match[1]), match[2] == "1")


def _triple(text: str) -> Triple:
    """Return the first three of the numbers in `text`, separated by commas; further axes are ignored."""
    values = _numbers(text)
    if len(values) < 3:
        raise GarbledLineError(f"not coordinates: {text!r}")
    return values[0], values[1], values[2]


def _numbers(text: str) -> list[float]:
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        raise GarbledLineError(f"not numbers: {text!r}") from None
    if not all(map(math.isfinite, values)):
        raise GarbledLineError(f"not numbers: {text!r}")
    return values
