"""Text of a TOML file with a comment for every line."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Mapping, Sequence

Value = str | bool | float | Sequence["Value"] | Mapping[str, "Value"]

COLUMN = 44
"""Column at which comments begin if the value before them is short enough."""
WIDTH = 120


class TomlText:
    """Lines of a TOML file that is written from top to bottom."""

    def __init__(self) -> None:
        self._lines: list[str] = []

    def comment(self, text: str) -> None:
        """Add a comment, wrapped to the width of the file."""
        self._lines += textwrap.wrap(text, WIDTH, initial_indent="# ", subsequent_indent="# ", break_on_hyphens=False)

    def section(self, name: str, comment: str = "") -> None:
        """Begin the section `name`, with an explanation above it."""
        self._lines.append("")
        if comment:
            self.comment(comment)
        self._lines.append(f"[{name}]")

    def key(self, name: str, value: Value, comment: str = "") -> None:
        """Add a key. Its comment follows the value or, if the line would be too long, precedes it. A list that is too
        long for a line is written with one item per line.
        """
        line = f"{name} = {format_value(value)}"
        if len(line) > WIDTH and isinstance(value, list):
            if comment:
                self.comment(comment)
            self.rows(name, value)
            return
        if comment:
            behind = f"{line.ljust(COLUMN - 1)} # {comment}"
            if len(behind) <= WIDTH:
                line = behind
            else:
                self.comment(comment)
        self._lines.append(line)

    def rows(self, name: str, rows: Sequence[Value]) -> None:
        """Add a key whose value is a list, with one item per line."""
        self._lines += [f"{name} = [", *(f"  {format_value(row)}," for row in rows), "]"]

    def __str__(self) -> str:
        return "\n".join(self._lines) + "\n"


def format_value(value: Value) -> str:
    """Return a value as TOML text. A whole number of type float keeps its decimal point."""
    match value:
        case str():
            return json.dumps(value, ensure_ascii=False)
        case bool():
            return "true" if value else "false"
        case Mapping():
            return "{ " + ", ".join(f"{name} = {format_value(item)}" for name, item in value.items()) + " }"
        case Sequence():
            return "[" + ", ".join(format_value(item) for item in value) + "]"
        case _:
            return repr(value)
