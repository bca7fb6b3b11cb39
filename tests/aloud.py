"""Skips of tests that this computer cannot run, reported aloud and counted."""

NOT_HERE = "NOT EXERCISED HERE"
"""Prefix of the reason of such a skip."""
