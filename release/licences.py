"""Licences of packages as SPDX expressions, and the audit against the list of those that are allowed.

A package states its licence in one of three ways: as an expression (PEP 639), in a free field, or by a classifier. Only
what is one SPDX expression without doubt is taken; "BSD License" is not. The others are stated in licences.toml, each
for one version, after their text was read.
"""

from __future__ import annotations

import tomllib
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from email.message import Message
from functools import cache
from pathlib import Path
from typing import Any

from license_expression import ExpressionError, Licensing, get_spdx_licensing

from release.packages import PROJECT, ROOT, Installed, Package

LIST = "release/licences.toml"
CLASSIFIED = {
    "Apache Software License": "Apache-2.0",
    "GNU Lesser General Public License v3 or later (LGPLv3+)": "LGPL-3.0-or-later",
    "ISC License (ISCL)": "ISC",
    "MIT License": "MIT",
    "Mozilla Public License 2.0 (MPL 2.0)": "MPL-2.0",
}
"""SPDX identifiers of the classifiers that mean one licence only. Version 1 of the Apache licence is not meant by any
package of this century."""


@dataclass(frozen=True)
class StatedLicence:
    """Licence of one version of a package whose metadata do not state it as an SPDX expression."""

    version: str
    expression: str


@dataclass(frozen=True)
class LicenceList:
    """Allowed SPDX identifiers, and licences that packages do not state themselves, by canonical name.

    `shipped` are allowed in what is delivered, and `development` also in what only builds and tests.
    """

    shipped: frozenset[str]
    development: frozenset[str]
    stated: Mapping[str, StatedLicence]


def read_licence_list(path: Path = ROOT / LIST) -> LicenceList:
    """Return the content of licences.toml."""
    content: Mapping[str, Any] = tomllib.loads(path.read_text(encoding="utf-8"))
    shipped = frozenset(content["allowed"]["shipped"])
    stated = {name: StatedLicence(**one) for name, one in content["stated"].items()}
    return LicenceList(shipped, shipped | frozenset(content["allowed"]["development"]), stated)


def licence_of(package: Package, stated: Mapping[str, StatedLicence]) -> str | None:
    """Return the licence of a package as an SPDX expression in canonical spelling, or None if it is not known."""
    known = stated.get(package.name)
    if known is not None:
        return normalized(known.expression) if known.version == package.version else None
    return next(filter(None, map(normalized, _candidates(package.metadata))), None)


def normalized(expression: str) -> str | None:
    """Return an SPDX expression in canonical spelling, or None if the text is not one."""
    try:
        parsed = _spdx().parse(expression, validate=True, strict=True)
    except ExpressionError:
        return None
    return None if parsed is None else str(parsed)


def is_allowed(expression: str, allowed: Collection[str]) -> bool:
    """Return True if the licence permits a use under `allowed` identifiers: all parts of a conjunction (AND), and at
    least one of an alternative (OR). An exception (WITH) must be listed together with its licence."""
    return _holds(_spdx().parse(expression, validate=True, strict=True), allowed)


def audit_licences(installed: Installed, shipped: Collection[str], licences: LicenceList) -> list[str]:
    """Return what is wrong with the licences, one sentence for each finding. `shipped` are the names of the packages
    that are delivered; the others only build and test."""
    findings = list(_outdated(installed, licences.stated))
    for name, package in installed.items():
        if name == PROJECT:
            continue
        expression = licence_of(package, licences.stated)
        allowed, use = (
            (licences.shipped, "shipped") if name in shipped else (licences.development, "used in development")
        )
        if expression is None:
            findings.append(
                f"{name} {package.version}: its metadata state no SPDX licence ({_said(package.metadata)}); "
                f"read its licence text and state it under [stated] in {LIST}"
            )
        elif not is_allowed(expression, allowed):
            findings.append(
                f"{name} {package.version} is {use}, but {expression} is not allowed; replace the package, "
                f"or decide to allow the licence in {LIST}"
            )
    return findings


def _outdated(installed: Installed, stated: Mapping[str, StatedLicence]) -> Iterator[str]:
    for name, licence in stated.items():
        if name not in installed:
            yield f"{LIST}: {name} is not installed; remove the entry"
        elif installed[name].version != licence.version:
            yield f"{LIST}: the licence of {name} was read for {licence.version}, not for {installed[name].version}"
        elif normalized(licence.expression) is None:
            yield f"{LIST}: {name}: `{licence.expression}` is not an SPDX expression"


def _candidates(metadata: Message) -> Iterator[str]:
    yield from metadata.get_all("License-Expression", [])
    yield from (line.strip() for line in metadata.get_all("License", []) if "\n" not in line.strip())
    meant = {CLASSIFIED.get(one) for one in _classifiers(metadata)}
    if len(meant) == 1:
        yield from filter(None, meant)


def _classifiers(metadata: Message) -> list[str]:
    """Return the last parts of the licence classifiers, without those that name no licence."""
    lines: Iterable[str] = metadata.get_all("Classifier", [])
    last = [line.rpartition(" :: ")[2] for line in lines if line.startswith("License ::")]
    return [one for one in last if one not in ("OSI Approved", "DFSG approved")]


def _said(metadata: Message) -> str:
    free = [line.strip().splitlines()[0] for line in metadata.get_all("License", []) if line.strip()]
    return "; ".join([*_classifiers(metadata), *free]) or "nothing"


def _holds(node: Any, allowed: Collection[str]) -> bool:
    if isinstance(node, _spdx().AND):
        return all(_holds(one, allowed) for one in node.args)
    if isinstance(node, _spdx().OR):
        return any(_holds(one, allowed) for one in node.args)
    return str(node) in allowed


@cache
def _spdx() -> Licensing:
    """Return the parser of SPDX expressions. It takes a moment to be made."""
    return get_spdx_licensing()
