"""A term is explained once, in the glossary: no docstring repeats its definition in parentheses."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
ROOMS = ("agent", "campaigns", "drivers", "simulators", "twin", "volcal")
PARENTHESIS = re.compile(r"((?:[\w'`-]+ ){0,3}[\w'`-]+) \(((?:[^()]|\([^()]*\))*)\)")
REPEATED = 0.6
"""Share of the words of a parenthesis that occur in the glossary's definition, from which it repeats the definition."""
SMALL_WORDS = frozenset(
    re.findall(
        r"\w+",
        "a all an and are as at be by can for from has have in into is it its not of on one or than that the their "
        "this to was were which with",
    )
)
ENDINGS = ("ations", "ation", "ements", "ement", "ings", "ing", "ied", "ies", "es", "ed", "s", "e")


def stem(word: str) -> str:
    """`word` without its ending, so that singular and plural, verb and noun agree."""
    word = word.lower()
    return next((word[: -len(end)] for end in ENDINGS if word.endswith(end) and len(word) - len(end) >= 3), word)


def stems(text: str) -> list[str]:
    return [stem(word) for word in re.findall(r"[a-z]+", text.lower()) if word not in SMALL_WORDS]


@cache
def definitions() -> dict[tuple[str, ...], frozenset[str]]:
    """Stems of the definition by the stems of the term."""
    page = (ROOT / "docs" / "reference" / "glossary.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (.+?) \| (.+?) \| .+? \|$", page, re.MULTILINE)
    return {
        tuple(stems(term)): frozenset(stems(meaning))
        for terms, meaning in rows
        if terms != "term"
        for term in terms.split(", ")
    }


def repeated_definitions(text: str) -> Iterator[str]:
    """Parentheses of `text` that repeat the definition of the term before them, with this term."""
    for before, inside in PARENTHESIS.findall(" ".join(text.split())):
        ending = stems(before)
        meanings = [m for term, m in definitions().items() if tuple(ending[-len(term) :]) == term]
        said = stems(inside)
        if len(said) < 2 or "`" in inside:
            continue
        if any(sum(word in meaning for word in said) >= REPEATED * len(said) for meaning in meanings):
            yield f"{before} ({inside})"


def docstrings(path: Path) -> Iterator[tuple[int, str]]:
    """Line and text of each docstring; strings below a constant or a field are docstrings too."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield node.lineno, node.value.value


@pytest.mark.parametrize("room", ROOMS)
def test_no_docstring_repeats_a_definition_of_the_glossary(room: str) -> None:
    found = [
        f"{path.relative_to(ROOT)}:{line}: {repeated}"
        for path in sorted((ROOT / room).rglob("*.py"))
        for line, text in docstrings(path)
        for repeated in repeated_definitions(text)
    ]
    assert not found, "say the term alone, docs/reference/glossary.md explains it:\n" + "\n".join(found)


@pytest.mark.parametrize(
    "text",
    [
        "Until a slot (machine time available for a night) ends.",
        "Checked by preflights (simulated executions of the plan) only.",
        "Scales (factors on the standard deviations of noise, prior and misfit).",
        "The last accepted night (the last run whose estimate was accepted as the reference) is read.",
        "Held-out balls (measured, but not used for the estimate).",
        "Return a rig (all devices of the machine).",
    ],
)
def test_a_repeated_definition_is_found(text: str) -> None:
    assert list(repeated_definitions(text))


@pytest.mark.parametrize(
    "text",
    [
        "Return arrays (n, k, 3).",
        "The active bank (0 if no table is active).",
        "What rotates with the mount (artefact and shaft).",
        "The result is a `Touch` (`fast_mm` is its overtravel).",
    ],
)
def test_a_parenthesis_that_says_something_else_is_no_repetition(text: str) -> None:
    assert not list(repeated_definitions(text))


@pytest.mark.parametrize("room", ROOMS)
def test_each_package_names_the_glossary(room: str) -> None:
    docstring = ast.get_docstring(ast.parse((ROOT / room / "__init__.py").read_text(encoding="utf-8")))
    assert docstring is not None
    assert "docs/reference/glossary.md" in docstring
