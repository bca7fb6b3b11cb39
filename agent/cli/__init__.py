"""Command line with one module per command. All errors are printed in `agent.cli.errors`."""
