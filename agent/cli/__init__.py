"""Command line `volcal` of the calibration agent, with one module per command. The module `agent.cli.errors` prints the
errors of all commands.
"""
