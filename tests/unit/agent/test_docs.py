"""The reference pages against what they describe: settings, JSON keys, commands and options."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import pytest
from service_house import outcome

from agent.cli.main import LazyGroup, main
from agent.execution.states import RunState

ROOT = Path(__file__).resolve().parents[3]
REFERENCE = ROOT / "docs" / "reference"
CODE = re.compile(r"`([^`]+)`")
KEY = re.compile(r"^`([a-z0-9_.]+)`$")


def page(name: str) -> str:
    return (REFERENCE / name).read_text(encoding="utf-8")


def rows(text: str) -> Iterator[list[str]]:
    """The cells of every line of a table; a bar in a cell has a backslash before it."""
    for line in text.splitlines():
        if line.startswith("|"):
            yield [cell.strip() for cell in re.split(r"(?<!\\)\|", line.strip("|"))]


def section(text: str, heading: str) -> str:
    """From a heading to the next one of its level."""
    return text.split(f"\n## {heading}\n", 1)[1].split("\n## ", 1)[0]


def documented_settings() -> dict[str, str]:
    """Key to default as the page has them: `required`, or JSON."""
    tables = re.split(r"\n(?=\| key \|)", page("settings.md"))[1:]
    cells = [row for table in tables for row in rows(table.split("\n\n", 1)[0])]
    return {key.group(1): default.strip("`") for first, default, _ in cells if (key := KEY.match(first))}


def schema_settings() -> dict[str, str]:
    """The same from the committed schema."""
    schema = json.loads((ROOT / "config" / "schema" / "settings.json").read_text(encoding="utf-8"))
    return dict(_leaves(schema, schema["$defs"], ""))


def _leaves(node: dict[str, Any], kinds: dict[str, Any], prefix: str) -> Iterator[tuple[str, str]]:
    for name, entry in node["properties"].items():
        kind = kinds[entry["$ref"].rpartition("/")[2]] if "$ref" in entry else entry
        if "properties" in kind:
            yield from _leaves(kind, kinds, f"{prefix}{name}.")
        else:
            required = name in node.get("required", [])
            yield prefix + name, "required" if required else json.dumps(entry["default"])


def test_the_settings_page_has_every_key_with_its_default() -> None:
    assert documented_settings() == schema_settings()


def test_the_settings_page_says_something_of_most_keys() -> None:
    """Empty cells are for lengths that are named by what they measure."""
    silent = [cells[0] for cells in rows(page("settings.md")) if len(cells) == 3 and not cells[2]]
    assert [key for key in silent if not key.startswith(("`mount.", "`probe.", "`procedure.", "`timing."))] == []


def test_the_json_page_has_the_keys_of_a_run_in_their_order() -> None:
    documented = section(page("json.md"), "`calibrate`, `demo`").split("`demo` adds")[0]
    keys = [key.group(1) for cells in rows(documented) if (key := KEY.match(cells[0]))]
    assert keys == list(outcome("a", RunState.COMPLETE, None).as_json())


def commands() -> Iterator[tuple[str, click.Command]]:
    assert isinstance(main, LazyGroup)
    context = click.Context(main)
    for name in main.list_commands(context):
        command = main.get_command(context, name)
        assert command is not None
        if isinstance(command, click.Group):
            yield from ((f"{name} {inner}", kept) for inner, kept in command.commands.items())
        if not isinstance(command, click.Group) or command.invoke_without_command:
            yield name, command


def test_the_command_page_lists_every_command() -> None:
    listed = {code for cells in rows(page("cli.md")) for code in CODE.findall(cells[0])}
    assert {f"volcal {name}" for name, _ in commands()} <= listed


@pytest.mark.parametrize("name", [name for name, _ in commands()])
def test_the_command_page_names_every_option(name: str) -> None:
    command = dict(commands())[name]
    text = page("cli.md")
    options = [max(p.opts, key=len) for p in command.params if isinstance(p, click.Option)]
    assert [option for option in options if f"`{option}`" not in text] == []
