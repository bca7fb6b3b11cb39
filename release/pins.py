"""Audit of the pins: constraints.txt states one exact version of every package that pyproject.toml needs, of no other,
and those are the ones installed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from packaging.requirements import InvalidRequirement, Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

from release.errors import ReleaseRefused
from release.packages import PROJECT, Installed, applies, reached, required

CONSTRAINTS = "constraints.txt"
BOOTSTRAP = frozenset({PROJECT, "pip"})
"""Packages without a pin: this project, and the installer, which a new virtual environment brings along."""


def audit_pins(project: Mapping[str, Any], constraints: str, installed: Installed) -> list[str]:
    """Return what is wrong with the pins, one sentence for each finding.

    `project` is the content of pyproject.toml, `constraints` the text of constraints.txt. A pin with a marker counts
    only where the marker holds.
    """
    pins, findings = read_pins(constraints)
    findings += _without_pin_or_different(pins, installed)
    findings += _against_project(project, pins)
    try:
        needed = set(reached(_all_required(project), installed))
    except ReleaseRefused as error:
        return [*findings, str(error)]
    findings += [
        f"{CONSTRAINTS}: {name} is pinned, but nothing needs it; remove the line" for name in sorted(set(pins) - needed)
    ]
    return findings


def read_pins(constraints: str) -> tuple[dict[str, Version], list[str]]:
    """Return the pinned versions by canonical name, and what is wrong with the lines."""
    pins: dict[str, Version] = {}
    findings = []
    for number, line in enumerate(constraints.splitlines(), start=1):
        text, where = line.partition("#")[0].strip(), f"{CONSTRAINTS}, line {number}"
        if not text:
            continue
        try:
            requirement = Requirement(text)
        except InvalidRequirement as error:
            findings.append(f"{where}: `{text}` is no requirement: {str(error).splitlines()[0]}")
            continue
        version = _exact(requirement)
        name = canonicalize_name(requirement.name)
        if version is None:
            findings.append(f"{where}: `{text}` does not pin one version; write `{requirement.name}==VERSION`")
        elif not applies(requirement, ()):
            continue
        elif name in pins:
            findings.append(f"{where}: {name} is pinned a second time; remove one of the lines")
        else:
            pins[name] = version
    return pins, findings


def _exact(requirement: Requirement) -> Version | None:
    specifiers = list(requirement.specifier)
    if requirement.url or len(specifiers) != 1 or specifiers[0].operator != "==" or "*" in specifiers[0].version:
        return None
    return Version(specifiers[0].version)


def _all_required(project: Mapping[str, Any]) -> tuple[Requirement, ...]:
    return required(project, project["project"]["optional-dependencies"])


def _without_pin_or_different(pins: Mapping[str, Version], installed: Installed) -> Iterator[str]:
    for name, package in installed.items():
        if name in BOOTSTRAP:
            continue
        if name not in pins:
            yield f"{name} {package.version} is installed without a pin; add it to {CONSTRAINTS} or uninstall it"
        elif Version(package.version) != pins[name]:
            yield f"{name} {package.version} is installed, but {CONSTRAINTS} pins {pins[name]}; run `make setup`"


def _against_project(project: Mapping[str, Any], pins: Mapping[str, Version]) -> Iterator[str]:
    build = tuple(Requirement(line) for line in project["build-system"]["requires"])
    for requirement in dict.fromkeys((*_all_required(project), *build)):
        name = canonicalize_name(requirement.name)
        if not applies(requirement, ()):
            continue
        if name not in pins:
            yield f"pyproject.toml requires {requirement}, which {CONSTRAINTS} does not pin"
        elif not requirement.specifier.contains(pins[name], prereleases=True):
            yield f"pyproject.toml requires {requirement}, but {CONSTRAINTS} pins {pins[name]}"
