"""Bytes in front of the world: servers and nodes written from the protocols' documents; no physics here."""
