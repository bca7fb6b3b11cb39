"""Waiting times of wire tests, in s."""

PATIENCE_S = 300.0
"""Time allowed for an answer that must come; a loaded computer may delay the other end."""
SILENCE_S = 0.2
"""Time after which an answer counts as missing or incomplete."""
