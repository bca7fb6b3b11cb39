"""The page of the scenario file has every key of the simulator with its default, and no other."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from simulators.scenario import ScenarioDocument

PAGE = Path(__file__).resolve().parents[3] / "docs" / "reference" / "scenario.md"
ROW = re.compile(r"^\| `([a-z0-9_.]+)` \| (.+?) \| (.+) \|$", re.MULTILINE)


EMPTY = {"array": "[]", "object": "{}"}


def leaves(node: dict[str, Any], kinds: dict[str, Any], prefix: str) -> Iterator[tuple[str, str]]:
    """Key to default: `required`, or JSON."""
    for name, entry in node["properties"].items():
        kind = kinds[entry["$ref"].rpartition("/")[2]] if "$ref" in entry else entry
        if "properties" in kind:
            yield from leaves(kind, kinds, f"{prefix}{name}.")
        elif name in node.get("required", []):
            yield f"{prefix}{name}", "required"
        else:
            yield f"{prefix}{name}", json.dumps(entry["default"]) if "default" in entry else EMPTY[entry["type"]]


def test_the_scenario_page_has_every_key_with_its_default_and_a_meaning() -> None:
    schema = ScenarioDocument.model_json_schema()
    written = {key: default.strip("`") for key, default, _ in ROW.findall(PAGE.read_text(encoding="utf-8"))}
    assert written == dict(leaves(schema, schema["$defs"], ""))
