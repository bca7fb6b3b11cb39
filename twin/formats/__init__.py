"""Neutral file formats: text to values and back. The caller reads and writes the files themselves."""
