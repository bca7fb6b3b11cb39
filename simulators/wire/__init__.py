"""Servers and nodes that exchange bytes with the world, written from the protocol documents; no physics here."""
