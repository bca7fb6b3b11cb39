"""Neutral files: text to values and back. Reading and writing of the files themselves is the caller's."""
