"""The bill of materials lists what is delivered, is valid, and is the same each time."""

from __future__ import annotations

import json
import re
from functools import cache
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement
from stated_packages import environment, of_this_interpreter, package

from release.errors import ReleaseRefused
from release.packages import ROOT, SHIPPED_EXTRAS, project_table, reached, required
from release.sbom import sbom_text, write_sbom

TIME = 1_700_000_000


@cache
def sbom() -> str:
    """Bill of materials of this environment."""
    requirements = required(project_table(), SHIPPED_EXTRAS)
    installed = of_this_interpreter()
    return sbom_text(installed["volcal"], requirements, reached(requirements, installed), TIME)


@pytest.fixture
def written() -> dict[str, Any]:
    content: dict[str, Any] = json.loads(sbom())
    return content


def test_it_is_written_under_the_version_of_the_program(tmp_path: Path) -> None:
    path = write_sbom(tmp_path / "new", of_this_interpreter(), TIME)
    assert path.name == f"volcal-{version('volcal')}.cdx.json"
    assert path.read_text() == sbom(), "the same packages give the same bytes"


def python_parts(document: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {one["purl"]: one for one in document["components"] if one.get("purl", "").startswith("pkg:pypi/")}


def test_it_says_what_it_is_and_of_when(written: dict[str, Any]) -> None:
    assert (written["bomFormat"], written["specVersion"]) == ("CycloneDX", "1.6")
    assert re.fullmatch(r"urn:uuid:[0-9a-f-]{36}", written["serialNumber"])
    assert written["metadata"]["timestamp"].startswith("2023-11-14T22:13:20")
    product = written["metadata"]["component"]
    assert (product["name"], product["type"]) == ("volcal", "application")
    assert product["licenses"] == [{"expression": "Apache-2.0"}]


def test_it_lists_every_shipped_package_at_its_pinned_version_and_no_tool(written: dict[str, Any]) -> None:
    pinned = dict(line.split("==") for line in (ROOT / "constraints.txt").read_text().split())
    canonical = {re.sub(r"[-_.]+", "-", name).lower(): number for name, number in pinned.items()}
    listed = {one.removeprefix("pkg:pypi/").partition("@")[::2] for one in python_parts(written)}
    assert {(name, canonical[name]) for name, _ in listed} == listed
    names = {name for name, _ in listed}
    assert {"numpy", "pydantic-core", "asyncua", "psycopg-binary", "weasyprint", "starlette"} <= names
    assert not names & {"pytest", "mypy", "setuptools", "dask", "pandas", "cyclonedx-python-lib"}
    assert all(one["licenses"] for one in python_parts(written).values())


def test_it_says_which_package_needs_which(written: dict[str, Any]) -> None:
    needs = {one["ref"].partition("@")[0]: one.get("dependsOn", []) for one in written["dependencies"]}

    def of(name: str) -> set[str]:
        return {ref.removeprefix("pkg:pypi/").partition("@")[0] for ref in needs[f"pkg:pypi/{name}"]}

    assert of("scipy") == {"numpy"}
    assert {"numpy", "asyncua", "psycopg", "fastapi"} <= of("volcal")
    assert "psycopg-binary" in of("psycopg"), "by the extra that volcal asks for"
    known = {one["bom-ref"] for one in written["components"]}
    assert {ref for refs in needs.values() for ref in refs} <= known


def test_it_lists_node_sets_by_hash_and_debians_packages(written: dict[str, Any]) -> None:
    files = sorted((ROOT / "agent/service/opcua/companion").glob("*.xml"))
    data = {one["name"]: one["hashes"] for one in written["components"] if one["type"] == "data"}
    assert data == {path.name: [{"alg": "SHA-256", "content": sha256(path.read_bytes()).hexdigest()}] for path in files}
    debian = {one["purl"] for one in written["components"] if one.get("purl", "").startswith("pkg:deb/")}
    assert {"pkg:deb/debian/systemd", "pkg:deb/debian/libpango-1.0-0"} <= debian
    assert not [one for one in debian if "@PYTHON@" in one or "%40" in one]


def test_another_package_gives_another_number(written: dict[str, Any]) -> None:
    product = package("volcal", "0.1.0", License_Expression="Apache-2.0")

    def number(*numpy: str) -> str:
        shipped = environment(*(package("numpy", one, License_Expression="BSD-3-Clause") for one in numpy))
        found: str = json.loads(sbom_text(product, tuple(map(Requirement, shipped)), shipped, TIME))["serialNumber"]
        return found

    assert len({number(), number("2.4.6"), number("2.4.7"), written["serialNumber"]}) == 4


def test_a_package_without_a_known_licence_is_refused() -> None:
    product = package("volcal", "0.1.0", License_Expression="Apache-2.0", Summary="calibration")
    shipped = environment(package("silent", "1.0", License="BSD"))
    with pytest.raises(ReleaseRefused, match=r"the licence of silent 1\.0 is not known"):
        sbom_text(product, (Requirement("silent"),), shipped, TIME)
