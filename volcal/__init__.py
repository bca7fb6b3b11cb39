"""volcal as a library."""
