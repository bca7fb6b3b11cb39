"""The command line: one module a command, errors printed in one place."""
