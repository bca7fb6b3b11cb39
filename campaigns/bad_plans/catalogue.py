"""Catalogue of all bad plans. Each plan has a unique name.

In the plans that are made here, one numeric settings key is NaN, infinite or out of range. All numeric keys are
covered.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from agent.settings.schema import Settings
from campaigns.bad_plans.files import file_plans
from campaigns.bad_plans.mutation import BadPlan, setting
from campaigns.bad_plans.steps import step_plans
from drivers.errors import ConfigurationError

MAY_BE_NEGATIVE = ("mount.table_z_mm", "mount.head_mm")
EVERYWHERE = {"nan": math.nan, "inf": math.inf}


def bad_plans() -> list[BadPlan]:
    plans = [*file_plans(), *step_plans(), *number_plans()]
    assert len({bad.name for bad in plans}) == len(plans)
    return plans


def number_plans() -> list[BadPlan]:
    """Return, for every numeric key of the settings schema, one bad plan for each wrong value of the key.

    A bad plan has settings that the agent must refuse because the key is NaN, infinite or out of range.
    """
    schema = Settings.model_json_schema()
    return [bad for path, kind in _numbers(schema, schema, "") for bad in _wrong_at(path, kind)]


def _wrong_at(path: str, kind: dict[str, Any]) -> Iterator[BadPlan]:
    wrong: dict[str, object] = dict(EVERYWHERE)
    if path not in MAY_BE_NEGATIVE:
        wrong["negative"] = kind.get("minimum", 0) - 1
    if "maximum" in kind:
        wrong["too large"] = kind["maximum"] + 1
    if "exclusiveMinimum" in kind:
        wrong["zero"] = kind["exclusiveMinimum"]
    for name, value in wrong.items():
        yield BadPlan(f"{path} {name}", setting(path, value), ConfigurationError, (path,))


def _numbers(schema: dict[str, Any], node: dict[str, Any], path: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the path and schema of every key whose value is a single number."""
    if "$ref" in node:
        node = schema["$defs"][node["$ref"].rsplit("/", 1)[1]]
    branches = node.get("anyOf", [])
    if any(branch.get("enum") or branch.get("const") for branch in branches):
        return
    for branch in branches:
        yield from _numbers(schema, branch, path)
    if node.get("type") in ("number", "integer") and "enum" not in node:
        yield path, node
    for name, part in node.get("properties", {}).items():
        yield from _numbers(schema, part, f"{path}.{name}".lstrip("."))
