"""How a test says that this computer lacks what it needs."""

NOT_HERE = "NOT EXERCISED HERE"
"""How the reason of such a skip begins: said aloud at the end of all tests, and counted."""
