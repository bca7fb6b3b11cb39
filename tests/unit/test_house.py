"""Rules of the house that no linter knows: size of folders and modules, one meaning per class name, docstrings."""

from __future__ import annotations

import ast
import re
from collections import Counter, defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
ROOMS = ("agent", "benchmarks", "campaigns", "drivers", "gcode", "release", "simulators", "twin", "volcal")
MOST_MODULES = 25
SMALL_LINES = 40

SMALL = {
    "one module a plugin, found by its entry point": (
        "drivers.canopen_mount.plugin",
        "drivers.linuxcnc.plugin",
        "drivers.modbus_cnc.plugin",
        "drivers.serial_cnc.plugin",
    ),
    "one module a command, found by its name": ("agent.cli.service_commands.serve",),
    "loaded by its name, after the packages that are observed": ("campaigns.fuzz.catalogue", "campaigns.fuzz.planted"),
    "one module a table format": ("twin.compensation.controllers.gcode_csv", "twin.compensation.controllers.neutral"),
    "a program of its own": ("agent.service.http.description", "campaigns.fortnight.serving"),
    "a role, apart from the processes that play it": ("agent.reports.renderer",),
    "sqlite3 is confined to the journal's own modules": ("agent.execution.journal_copy",),
    "it logs, and the rest of its room does not": ("agent.history.feed",),
    "it imports matplotlib, which is loaded only for a figure": (
        "agent.workpiece.place_figure",
        "volcal.notebook_figure",
    ),
    "one step of the run, beside its siblings": ("agent.runs.resume.abandon",),
    "a rule for moves, apart from the resumption that follows it": ("agent.runs.resume.slow_moves",),
    "one step of the report, after all that draws": ("agent.reports.page.german",),
    "a file format, beside the one that it changes": ("twin.formats.moved_estimate",),
}
"""Modules of under 40 lines with at most one importer, by the reason to stand alone."""

RELATIVE = re.compile(
    r"(What|Of|Where|Whether|Whose|When|Which|Who|How|Nothing|Those|The one|From where|By how)\b",
)


@cache
def modules() -> dict[str, Path]:
    """Paths by dotted name; a package by its own name."""
    paths = sorted(path for room in ROOMS for path in (ROOT / room).rglob("*.py"))
    names = (".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__") for path in paths)
    return dict(zip(names, paths, strict=True))


@cache
def trees() -> dict[str, ast.Module]:
    return {name: ast.parse(path.read_text(encoding="utf-8")) for name, path in modules().items()}


def imported_by(tree: ast.Module) -> Iterator[str]:
    """Names of the modules that an import statement anywhere in the module refers to."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)


def test_no_folder_has_more_modules_than_can_be_read_at_a_glance() -> None:
    counts = Counter(path.parent for path in modules().values() if path.name != "__init__.py")
    assert {str(folder): count for folder, count in counts.items() if count > MOST_MODULES} == {}


def test_a_small_module_with_one_importer_says_why() -> None:
    importers: dict[str, set[str]] = defaultdict(set)
    for name, tree in trees().items():
        for imported in imported_by(tree):
            importers[imported].add(name)
    small = {
        name
        for name, path in modules().items()
        if path.name not in ("__init__.py", "__main__.py")
        and len(path.read_text(encoding="utf-8").splitlines()) < SMALL_LINES
        and len(importers[name] - {name}) <= 1
    }
    assert small - {name for names in SMALL.values() for name in names} == set()


def test_the_small_modules_that_are_listed_exist() -> None:
    assert {name for names in SMALL.values() for name in names} - set(modules()) == set()


def test_a_public_class_name_has_one_meaning() -> None:
    places: dict[str, list[str]] = defaultdict(list)
    for name, tree in trees().items():
        for node in tree.body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(name)
    assert {name: where for name, where in places.items() if len(where) > 1} == {}


def docstrings() -> Iterator[tuple[str, str]]:
    """Docstrings of modules, classes and functions with the place of each."""
    for name, tree in trees().items():
        for node in ast.walk(tree):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
                text = ast.get_docstring(node)
                if text:
                    yield f"{name}:{getattr(node, 'lineno', 1)}", text


def test_docstrings_do_not_complete_the_name_as_a_relative_clause() -> None:
    assert [place for place, text in docstrings() if RELATIVE.match(text)] == []


@pytest.mark.parametrize(
    ("text", "relative"),
    [
        ("What the run needs.", True),
        ("Of the last thousand.", True),
        ("Offset of the tool.", False),
        ("Return x.", False),
    ],
)
def test_the_pattern_knows_a_relative_beginning(text: str, relative: bool) -> None:
    assert bool(RELATIVE.match(text)) is relative
