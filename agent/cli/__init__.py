"""Command line of the agent, with one module per command. The module `agent.cli.errors` prints the errors of all
commands.
"""
