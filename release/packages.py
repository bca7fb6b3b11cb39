"""Installed Python packages, and those of them that a set of requirements reaches."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from email.message import Message
from importlib.metadata import Distribution, distributions
from pathlib import Path
from typing import Any, cast

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from release.errors import ReleaseRefused

ROOT = Path(__file__).resolve().parents[1]
PROJECT = "volcal"
SHIPPED_EXTRAS = ("opcua", "postgres")
"""Optional dependencies that the Debian package contains. A cluster for studies belongs on another computer."""


@dataclass(frozen=True)
class Package:
    """Installed package. `name` is the canonical name of PyPI, `spelled` the one of its metadata, and `requirements`
    those of all extras, with their markers."""

    name: str
    spelled: str
    version: str
    metadata: Message
    requirements: tuple[Requirement, ...]


Installed = Mapping[str, Package]
"""Installed packages by canonical name."""


def installed_packages(site: Path | None = None) -> Installed:
    """Return the packages in the folder `site`, or those of this interpreter if `site` is None."""
    found = distributions() if site is None else distributions(path=[str(site)])
    packages = [_package(one) for one in found]
    return {one.name: one for one in sorted(packages, key=lambda one: one.name)}


def project_table(root: Path = ROOT) -> Mapping[str, Any]:
    """Return the content of pyproject.toml."""
    return tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))


def required(project: Mapping[str, Any], extras: Iterable[str]) -> tuple[Requirement, ...]:
    """Return the requirements of the project with these extras, from the content of its pyproject.toml."""
    table = project["project"]
    lines = [*table["dependencies"], *(line for extra in extras for line in table["optional-dependencies"][extra])]
    return tuple(Requirement(line) for line in lines)


def reached(requirements: Iterable[Requirement], installed: Installed) -> Installed:
    """Return the installed packages that the requirements need in this environment, directly or not.

    Raises ReleaseRefused if one of them is not installed.
    """
    return {name: installed[name] for name in sorted(reached_extras(requirements, installed))}


def reached_extras(requirements: Iterable[Requirement], installed: Installed) -> dict[str, frozenset[str]]:
    """Return the extras that are asked of each package that the requirements need, by canonical name. See `reached`."""
    found: dict[str, frozenset[str]] = {}
    waiting = [one for one in requirements if applies(one, ())]
    while waiting:
        requirement = waiting.pop()
        name = canonicalize_name(requirement.name)
        if name not in installed:
            raise ReleaseRefused(f"{name} is required but not installed: run `make setup`")
        former = found.get(name)
        extras = frozenset(requirement.extras) | (former or frozenset())
        if extras != former:
            found[name] = extras
            waiting += direct(installed[name], extras)
    return found


def direct(package: Package, extras: Iterable[str] = ()) -> Iterator[Requirement]:
    """Yield the requirements of a package with these extras that apply in this environment."""
    return (one for one in package.requirements if applies(one, extras))


def applies(requirement: Requirement, extras: Iterable[str]) -> bool:
    """Return True if the marker of a requirement holds in this environment with one of the extras or without any."""
    marker = requirement.marker
    return marker is None or any(marker.evaluate({"extra": extra}) for extra in ("", *extras))


def _package(distribution: Distribution) -> Package:
    metadata = cast(Message, distribution.metadata)  # each access reads the file anew
    spelled, lines = str(metadata["Name"]), metadata.get_all("Requires-Dist", [])
    return Package(
        canonicalize_name(spelled), spelled, str(metadata["Version"]), metadata, tuple(map(Requirement, lines))
    )
