"""Errors of the commands that make release files."""


class ReleaseRefused(Exception):
    """A release file cannot be made. The text says what is wrong, where, and what to do."""
