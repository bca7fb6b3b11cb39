"""The list of commands imports none of them, and what speaks to the service loads neither mathematics nor drivers."""

from __future__ import annotations

import subprocess
import sys

import click
import pytest

from agent.cli.main import LONGEST_HELP, OWN_COMMANDS, main

SLOW = ("scipy", "matplotlib", "sqlalchemy", "fastapi", "pymodbus", "canopen")


@pytest.mark.parametrize("name", OWN_COMMANDS)
def test_the_list_says_of_a_command_what_its_own_help_says(name: str) -> None:
    command = main.get_command(click.Context(main), name)
    assert command is not None
    assert command.name == name
    assert OWN_COMMANDS[name].says == command.get_short_help_str(LONGEST_HELP)


def test_the_help_lists_own_commands_and_those_of_other_packages() -> None:
    said = main.get_help(click.Context(main))
    for name in (*OWN_COMMANDS, "simulate"):
        assert f"\n  {name} " in said
    assert "..." not in said.partition("Commands:")[2]


@pytest.mark.parametrize(
    "module",
    ["agent.cli.service_commands.requests", "agent.cli.service_commands.start", "agent.cli.service_commands.status"],
)
def test_who_wants_to_stop_a_machine_waits_for_no_import(module: str) -> None:
    loaded = subprocess.run(
        [sys.executable, "-c", f"import {module}, sys; print(*sys.modules)"], capture_output=True, text=True, check=True
    ).stdout.split()
    assert module in loaded
    assert [name for name in SLOW if name in loaded] == []
