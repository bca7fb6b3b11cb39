"""Command line: one module per command, errors printed in one place."""
