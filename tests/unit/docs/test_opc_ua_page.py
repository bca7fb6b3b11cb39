"""The page on OPC UA against the model in the code."""

from __future__ import annotations

import re
from pathlib import Path

from agent.service.opcua.machine_model import MACHINE_VARIABLES, STATE_MACHINES
from agent.service.opcua.measuring_model import ADDITIONS
from agent.service.opcua.model import (
    EVENT_TYPES,
    METHODS,
    NAMESPACE,
    OWN_VARIABLES,
    PROGRAM_STATES,
    VARIABLES,
    Argument,
)
from agent.service.opcua.node_set_files import NODE_SETS, read_node_sets

PAGE = (Path(__file__).parents[3] / "docs" / "reference" / "opc-ua.md").read_text(encoding="utf-8")

SHIPPED = Path(__file__).parents[3] / "agent" / "service" / "opcua" / "companion"


def section(heading: str) -> list[list[str]]:
    """The cells of the rows of a section's table."""
    text = PAGE.split(f"\n## {heading}\n", 1)[1].split("\n## ", 1)[0]
    rows = [line for line in text.splitlines() if line.startswith("| `")]
    return [[cell.strip() for cell in re.split(r"(?<!\\)\|", line.strip("|"))] for line in rows]


def listed(arguments: tuple[Argument, ...]) -> str:
    return "; ".join(f"`{a.name}` {a.form}: {a.meaning}" for a in arguments)


def test_every_node_stands_on_the_page():
    nodes = [(variable.path, variable.form, variable.meaning) for variable in VARIABLES]
    assert section("Nodes to read") == [
        [f"`{path}`", form, meaning] for path, form, meaning in [*nodes, *OWN_VARIABLES]
    ]


def test_every_method_stands_on_the_page():
    expected = [[f"`{m.name}`", listed(m.inputs), listed(m.outputs), m.meaning] for m in METHODS]
    assert section("Methods") == expected


def test_every_event_stands_on_the_page():
    assert section("Events") == [[f"`{e.name}`", str(e.severity), listed(e.fields), e.meaning] for e in EVENT_TYPES]


def test_every_node_of_the_machine_stands_on_the_page():
    variables = [[f"`{one.path}`", one.form, one.meaning] for one in MACHINE_VARIABLES]
    machines = [[f"`{one.path}`", one.type.name, one.meaning] for one in STATE_MACHINES]
    assert section("Machine") == variables + machines


def test_every_node_of_a_further_node_set_stands_on_the_page():
    for addition in ADDITIONS:
        variables = [[f"`{one.path}`", one.form, one.meaning] for one in addition.variables]
        machines = [[f"`{one.path}`", one.type.name, one.meaning] for one in addition.state_machines]
        assert section(addition.specification) == variables + machines
        assert addition.namespace in PAGE


def test_every_node_set_that_is_shipped_stands_on_the_page_and_has_its_licence():
    found = read_node_sets(SHIPPED)
    assert section("Node sets") == [
        [f"`{found[one.uri].path.name}`", one.specification, f"`{one.uri}`", found[one.uri].version, one.version]
        for one in NODE_SETS
    ]
    assert len(found) == len(NODE_SETS)
    for file in found.values():
        assert "OPC Foundation MIT License 1.00" in file.path.read_text(encoding="utf-8")


def test_names_in_the_text_are_those_of_the_code():
    assert f"Namespace `{NAMESPACE}`" in PAGE
    assert {method.name for method in METHODS if method.free} == {"Hold", "Abort"}
    assert all(state in PAGE for state in PROGRAM_STATES.values())
