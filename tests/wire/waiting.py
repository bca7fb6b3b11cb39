"""How long wire tests wait for the other end, s."""

PATIENCE_S = 5.0
"""For an answer that comes: a loaded computer may let the other end wait."""
SILENCE_S = 0.2
"""For one that does not come, or is too short."""
