"""Generator of the Python API reference from the docstrings.

The command is `python -m volcal.reference > docs/reference/python-api.md`.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from functools import cached_property
from textwrap import dedent, indent

import volcal

PREAMBLE = """\
>>> import volcal
>>> setup = volcal.case_study()
>>> balls = volcal.read_balls(volcal.shipped_file("examples/case-study-balls.csv"), setup.machine)
>>> estimate = volcal.identify(balls, setup.machine, setup.artefact, order=5)
>>> features = volcal.read_features(volcal.shipped_file("examples/bearing-plate.csv"))
>>> folder = "results"
"""

HEAD = """\
# Python API

This page is made from the docstrings by `python -m volcal.reference`; a test holds it against them. A start in ten
lines is [Use volcal in a notebook](../how-to/use-volcal-in-a-notebook.md). The files are described in
[Files](files.md), the mathematics in [Identification](../explanation/identification.md).

"""

SECTIONS = {
    "volcal.files": "Files",
    "volcal.measuring_setup": "Set-ups",
    "volcal.estimation": "Identification and prediction",
    "volcal.workpiece": "Workpieces",
    "volcal.position_design": "Design",
    "volcal.simulation": "Simulation",
    "volcal.compensation": "Compensation",
    "volcal.figures": "Figures",
    "volcal.frames": "Data frames",
}


def page() -> str:
    """Return the text of the Python API reference page in Markdown."""
    parts = [HEAD, f"{_prose(volcal)}\n\n", "The examples of this page start with:\n\n```python\n", PREAMBLE, "```\n"]
    for module, title in SECTIONS.items():
        parts.append(f"\n## {title}\n")
        parts += [_entry(name) for name in volcal.__all__ if _module(name) == module]
    parts.append("\n## Values of the twin\n\nTypes that the functions above take and return.\n")
    parts += [_entry(name) for name in volcal.__all__ if _module(name).startswith("twin.") and not _is_error(name)]
    parts.append("\n## Errors\n\nAll are a `TwinError`; the text names the file with its key, or row and column.\n")
    parts += [f"\n- `{name}`: {_error_text(name)}" for name in volcal.__all__ if _is_error(name)]
    return "".join(parts) + "\n"


def _module(name: str) -> str:
    value = getattr(volcal, name)
    return str(getattr(value, "__module__", "volcal.compensation"))


def _is_error(name: str) -> bool:
    value = getattr(volcal, name)
    return inspect.isclass(value) and issubclass(value, Exception)


def _error_text(name: str) -> str:
    """Return the description of an error, taken from the tree of errors in the docstring of `twin.errors`."""
    if name == "TwinError":
        return "root of the tree"
    tree = inspect.getdoc(sys.modules["twin.errors"]) or ""
    line = next(line for line in tree.splitlines() if f" {name} " in line)
    return line.partition(name)[2].strip()


def _entry(name: str) -> str:
    value = getattr(volcal, name)
    if inspect.isclass(value):
        return _class_entry(name, value)
    if callable(value):
        return f"\n### `{name}`\n\n```python\n{_signature(name, value)}\n```\n\n{_body(value)}"
    names = ", ".join(f"`{entry}`" for entry in value)
    return f"\n### `{name}`\n\nNames of the formats that `export_table` writes: {names}.\n"


def _class_entry(name: str, kind: type) -> str:
    lines = [f"\n### `{name}`\n\n{_body(kind)}"]
    if is_dataclass(kind):
        listed = ", ".join(f"`{field.name}`" for field in fields(kind) if not field.name.startswith("_"))
        lines.append(f"\nFields: {listed}.\n")
    members = [text for text in _members(kind) if text]
    if members:
        lines.append("\n" + "\n".join(members) + "\n")
    return "".join(lines)


def _members(kind: type) -> Iterator[str]:
    """Yield an entry for each public method and property that has a docstring, in source order."""
    for name, member in vars(kind).items():
        if name.startswith("_"):
            continue
        inner = member.__func__ if isinstance(member, classmethod) else member
        if isinstance(member, property | cached_property) and member.__doc__:
            yield f"- `{name}`: {_first_paragraph(member.__doc__)}"
        elif inspect.isfunction(inner) and inner.__doc__:
            yield f"- `{_signature(name, inner)}`: {_first_paragraph(inner.__doc__)}"


def _signature(name: str, function: object) -> str:
    """Return name and parameters without annotations, since the docstring describes the types."""
    if not callable(function):
        return name
    signature = inspect.signature(function)
    bare = [
        parameter.replace(annotation=inspect.Parameter.empty)
        for parameter in signature.parameters.values()
        if parameter.name not in ("self", "cls")
    ]
    return f"{name}{signature.replace(parameters=bare, return_annotation=inspect.Signature.empty)}"


def _body(value: object) -> str:
    """Return the docstring as Markdown: prose unchanged, examples as code blocks."""
    text = inspect.getdoc(value) or ""
    if text.startswith(f"{getattr(value, '__name__', '')}("):
        return ""  # the signature that a dataclass without a docstring makes
    prose, mark, example = text.partition(">>> ")
    code = f"\n\n```python\n{mark}{example.strip()}\n```" if mark else ""
    return f"{prose.strip()}{code}\n"


def _prose(value: object) -> str:
    return (inspect.getdoc(value) or "").strip()


def _first_paragraph(text: str) -> str:
    first = dedent(text).strip().split("\n\n")[0]
    return indent(" ".join(first.split()), "")


if __name__ == "__main__":
    sys.stdout.write(page())
