"""Command line with one module per command. `agent.cli.errors` prints all errors."""
