"""Numbers as texts for people."""

from __future__ import annotations


def significant(value: float, digits: int = 3) -> str:
    """Return `value` with `digits` significant digits. An exponent is used only for very small values."""
    text = f"{value:.{digits}g}"
    if "e" not in text:
        return text
    return f"{float(text):.0f}" if abs(value) >= 1.0 else f"{value:.1e}"
