"""Sentences for operators as they stand in the source: texts and hints of errors, notes, reasons and questions.

A sentence is a template: the parts of a formatted string that are computed stand as `{}`. What is found is judged by
tests/unit/agent/test_german_sentences.py.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
ROOMS = (
    "agent/execution",
    "agent/files.py",
    "agent/history",
    "agent/notifications",
    "agent/planning",
    "agent/probing",
    "agent/reports",
    "agent/results",
    "agent/runs",
    "agent/service/access",
    "agent/service/daemon/endpoints.py",
    "agent/service/gateway",
    "agent/service/http",
    "agent/service/opcua/certificates.py",
    "agent/service/opcua/endpoint.py",
    "agent/service/opcua/node_set_files.py",
    "agent/service/opcua/node_sets.py",
    "agent/service/opcua/server.py",
    "agent/service/owner",
    "agent/service/setup",
    "agent/service/state",
    "agent/service/page",
    "agent/service/alarms.py",
    "agent/service/allowed_requests.py",
    "agent/settings",
    "agent/thermal",
    "agent/workpiece",
    "drivers",
    "simulators/operator.py",
    "twin/artefact",
    "twin/collision/locating_balls.py",
    "twin/collision/measuring_layout.py",
    "twin/collision/probe_frame.py",
    "twin/collision/probe_geometry.py",
    "twin/compensation/table.py",
    "twin/formats",
    "twin/identification",
    "twin/machine",
    "twin/monitoring",
    "twin/thermal",
    "twin/workpiece",
)
"""Rooms whose sentences reach a person: during a run, when a run is started with its files, and in documents."""
APART = (
    "agent/planning/design",
    "agent/planning/new_machine",
    "agent/planning/preview",
    "agent/runs/new_machine_files.py",
    "agent/history/sensor_drift.py",
    "agent/history/thermal_nights.py",
    "agent/runs/offline",
    "agent/results/part_programs.py",
    "agent/service/page/setup_app.py",
    "agent/service/gateway/registers.py",
    "drivers/contract",
    "drivers/linuxcnc/bridge",
    "drivers/linuxcnc/installation",
    "twin/artefact/change_test.py",
    "twin/formats/digital_certificate",
    "twin/identification/hidden_step.py",
    "twin/identification/checks/shift_pattern.py",
    "twin/formats/moved_estimate.py",
    "twin/monitoring/drift_evidence.py",
    "twin/monitoring/seen_directions.py",
    "twin/monitoring/sensor_screening.py",
    "twin/monitoring/step_power.py",
    "twin/monitoring/thermal_drift.py",
    "twin/monitoring/thermal_regression.py",
)
"""Places in those rooms that a command or a test alone calls, before there is a machine, or that have only parts of
sentences: the whole ones are in agent/language/german/composed.json."""

REPORT_MODULES = tuple(
    path for room in ("agent/reports", "agent/history", "twin") for path in sorted((ROOT / room).rglob("*.py"))
)

HOLDERS = frozenset(
    ["reason", "note", "text", "complaint", "then", "situation", "instruction", "way_out", "hint", "detail", "why"]
)
"""Names of variables, arguments and entries of records that hold a sentence."""
HOLDER = re.compile(rf"(^|_)({'|'.join(HOLDERS)})s?$")
TELLING = re.compile(r"(^|_)(error|note|lost|refused|reason|fail|complain|invalid|inconsistent)$")
"""Names of functions that make an error or a note from a sentence."""
VALUE = re.compile(r"(\{\w+\} )+(mm|µm)")
"""Template of values with their unit, which is the same in each language."""
WORDS = re.compile(r"[a-z]{2,}[^{}]* [^{}]*[a-z]{2,}|[a-z]{2,} \{|\}[^{}]* [a-z]{2,}", re.DOTALL)


@cache
def error_classes() -> frozenset[str]:
    files = ("drivers/errors.py", "agent/errors.py", "twin/errors.py")
    trees = [ast.parse((ROOT / name).read_text(encoding="utf-8")) for name in files]
    return frozenset(node.name for tree in trees for node in tree.body if isinstance(node, ast.ClassDef))


@cache
def sentences() -> dict[str, str]:
    """Return the place in the source of each template."""
    found: dict[str, str] = {}
    for path in modules():
        place = path.relative_to(ROOT).as_posix()
        for line, template in _of_tree(ast.parse(path.read_text(encoding="utf-8"))):
            if not template.startswith("SELECT "):
                found.setdefault(template, f"{place}:{line}")
    return found


@cache
def all_texts() -> frozenset[str]:
    """Return every text of the rooms, also those that are not known to reach an operator."""
    trees = [ast.parse(path.read_text(encoding="utf-8")) for path in (*modules(), *REPORT_MODULES)]
    nodes = [node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.expr)]
    return frozenset(text for node in nodes if (text := _template(node)) is not None)


def modules() -> list[Path]:
    paths = [path for room in ROOMS for path in (sorted((ROOT / room).rglob("*.py")) or [ROOT / room])]
    return [path for path in paths if not path.relative_to(ROOT).as_posix().startswith(APART)]


def _of_tree(tree: ast.Module) -> Iterator[tuple[int, str]]:
    for expression in _telling(tree):
        for node, template in _templates(expression):
            if WORDS.search(template) and not VALUE.fullmatch(template):
                yield node.lineno, template


def _telling(tree: ast.Module) -> Iterator[ast.expr]:
    """Yield each expression whose value is told to an operator."""
    for node in ast.walk(tree):
        match node:
            case ast.Call():
                yield from _told_by_call(node)
            case ast.Assign(targets=[target], value=value) if HOLDER.search(_name(target).lower()):
                yield value
            case ast.AnnAssign(target=target, value=ast.expr() as value) if HOLDER.search(_name(target).lower()):
                yield value
            case ast.Dict(keys=keys, values=values):
                yield from (
                    value
                    for key, value in zip(keys, values, strict=True)
                    if isinstance(key, ast.Constant) and key.value in HOLDERS
                )
            case ast.FunctionDef(name=name) if HOLDER.search(name):
                yield from (one.value for one in ast.walk(node) if isinstance(one, ast.Return) and one.value)


def _told_by_call(call: ast.Call) -> Iterator[ast.expr]:
    name = _name(call.func)
    if name in error_classes() or TELLING.search(name):
        yield from call.args[:1]
    yield from (keyword.value for keyword in call.keywords if keyword.arg in HOLDERS)


def _name(node: ast.expr) -> str:
    return node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""


def _templates(node: ast.expr) -> Iterator[tuple[ast.expr, str]]:
    """Yield the template of a text, and those of the texts in its computed parts."""
    template = _template(node)
    if template is not None:
        yield node, template
    inner = [node] if template is None else [one.value for one in ast.walk(node) if isinstance(one, ast.FormattedValue)]
    for expression in inner:
        for child in ast.iter_child_nodes(expression):
            if isinstance(child, ast.expr):
                yield from _templates(child)
            elif isinstance(child, ast.keyword):
                yield from _templates(child.value)


def _template(node: ast.expr) -> str | None:
    match node:
        case ast.Constant(value=str() as text):
            return text
        case ast.JoinedStr(values=values):
            return "".join(str(one.value) if isinstance(one, ast.Constant) else _place(one) for one in values)
        case ast.BinOp(left=left, op=ast.Add(), right=right):
            parts = _template(left), _template(right)
            return None if None in parts else "".join(part for part in parts if part is not None)
    return None


def _place(part: ast.expr) -> str:
    """Return the place of a computed part, named after the last name in its expression."""
    names = [name for one in ast.walk(part) if (name := _name(one) if isinstance(one, ast.expr) else "")]
    return f"{{{names[0] if names else 'value'}}}"
