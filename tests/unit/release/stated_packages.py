"""Packages that tests make up, and those of this interpreter, read once."""

from __future__ import annotations

from email.message import Message
from functools import cache

from packaging.requirements import Requirement

from release.packages import Installed, Package, installed_packages


def package(name: str, version: str, *requirements: str, **headers: str | list[str]) -> Package:
    """Return an installed package with these requirements and metadata headers."""
    metadata = Message()
    for header, values in headers.items():
        for value in [values] if isinstance(values, str) else values:
            metadata[header.replace("_", "-")] = value
    return Package(name, name, version, metadata, tuple(map(Requirement, requirements)))


def environment(*packages: Package) -> dict[str, Package]:
    return {one.name: one for one in packages}


@cache
def of_this_interpreter() -> Installed:
    return installed_packages()
