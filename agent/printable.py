"""Text from other people and programs, made harmless for terminals, logs, panels and spreadsheets."""

from __future__ import annotations

REPLACEMENT = "\N{REPLACEMENT CHARACTER}"
FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r", "\n")
MAX_REASON = 200
"""Longest reason of an abort in characters. Anybody may abort, so the reason may be any text."""


def printable(text: str) -> str:
    """Return `text` with a replacement for every character that a terminal would obey instead of showing it, such as
    the escape character or a change of the writing direction. Line feeds stay."""
    return "".join(c if c.isprintable() or c == "\n" else REPLACEMENT for c in text)


def one_line(text: str, longest: int) -> str:
    """Return `text` in the same way on one line and with at most `longest` characters."""
    shown = printable(" ".join(text[: 4 * longest].split()))
    return shown if len(shown) <= longest else f"{shown[: longest - 1]}…"


def no_formula(text: str) -> str:
    """Return a text that no spreadsheet evaluates when it opens the file (OWASP, CSV injection)."""
    return f"'{text}" if text.startswith(FORMULA_STARTS) else text
