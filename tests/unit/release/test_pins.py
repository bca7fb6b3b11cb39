"""The audit of the pins finds every kind of drift between pyproject.toml, constraints.txt and what is installed."""

from __future__ import annotations

from typing import Any

import pytest
from stated_packages import environment, of_this_interpreter, package

from release.errors import ReleaseRefused
from release.packages import project_table, reached, required
from release.pins import CONSTRAINTS, audit_pins, read_pins

PROJECT: dict[str, Any] = {
    "build-system": {"requires": ["setuptools>=77"]},
    "project": {
        "dependencies": ["numpy>=2.0", "dask[array]>=1"],
        "optional-dependencies": {"dev": ["pytest>=9", "setuptools>=77", "winonly>=1; sys_platform == 'win32'"]},
    },
}
PINS = "dask==2.0\nnumpy==2.4.6\npluggy==1.7\npytest==9.2\nsetuptools==80.0\ntoolz==1.0\n"
INSTALLED = environment(
    package("dask", "2.0", "toolz>=1; extra == 'array'", "bokeh>=3; extra == 'plots'"),
    package("numpy", "2.4.6"),
    package("pip", "23.2"),
    package("pluggy", "1.7"),
    package("pytest", "9.2.0", "pluggy>=1.5", "colorama; sys_platform == 'win32'"),
    package("setuptools", "80.0"),
    package("toolz", "1.0"),
    package("volcal", "0.1.0"),
)


def test_pins_that_agree_have_no_finding() -> None:
    assert audit_pins(PROJECT, "# a remark\n\n" + PINS, INSTALLED) == []


@pytest.mark.parametrize(
    ("line", "text"),
    [
        ("numpy>=2.0", "line 7: `numpy>=2.0` does not pin one version"),
        ("numpy==2.*", "line 7: `numpy==2.*` does not pin one version"),
        ("numpy==2.4.6,!=2.4.5", "does not pin one version"),
        ("numpy", "does not pin one version; write `numpy==VERSION`"),
        ("numpy @ https://example.org/numpy.whl", "does not pin one version"),
        ("-e .", "line 7: `-e .` is no requirement"),
        ("NumPy==2.4.6", "line 7: numpy is pinned a second time"),
    ],
)
def test_a_line_that_pins_nothing_is_named(line: str, text: str) -> None:
    (finding,) = audit_pins(PROJECT, PINS + line + "\n", INSTALLED)
    assert finding.startswith(CONSTRAINTS)
    assert text in finding


def test_a_pin_for_another_system_counts_for_nothing() -> None:
    pins, findings = read_pins("winonly==1.0; sys_platform == 'win32'\n")
    assert (pins, findings) == ({}, [])


def test_an_installed_package_without_a_pin_is_found() -> None:
    found = audit_pins(PROJECT, PINS, INSTALLED | environment(package("leftpad", "1.0")))
    assert found == [f"leftpad 1.0 is installed without a pin; add it to {CONSTRAINTS} or uninstall it"]


def test_another_installed_version_is_found() -> None:
    found = audit_pins(PROJECT, PINS, INSTALLED | environment(package("toolz", "1.1")))
    assert found == [f"toolz 1.1 is installed, but {CONSTRAINTS} pins 1.0; run `make setup`"]


def test_a_pin_outside_the_requirement_of_the_project_is_found() -> None:
    found = audit_pins(
        PROJECT, PINS.replace("numpy==2.4.6", "numpy==1.26"), INSTALLED | environment(package("numpy", "1.26"))
    )
    assert found == [f"pyproject.toml requires numpy>=2.0, but {CONSTRAINTS} pins 1.26"]


def test_a_requirement_without_a_pin_is_found() -> None:
    found = audit_pins(PROJECT, PINS.replace("setuptools==80.0\n", ""), INSTALLED)
    assert f"pyproject.toml requires setuptools>=77, which {CONSTRAINTS} does not pin" in found


def test_a_pin_that_nothing_needs_is_found() -> None:
    found = audit_pins(PROJECT, PINS + "bokeh==3.0\n", INSTALLED | environment(package("bokeh", "3.0")))
    assert found == [f"{CONSTRAINTS}: bokeh is pinned, but nothing needs it; remove the line"]


def test_a_required_package_that_is_missing_is_found() -> None:
    installed = {name: one for name, one in INSTALLED.items() if name != "pluggy"}
    assert "pluggy is required but not installed: run `make setup`" in audit_pins(PROJECT, PINS, installed)
    with pytest.raises(ReleaseRefused, match="pluggy is required"):
        reached(required(PROJECT, ["dev"]), installed)


def test_extras_are_followed_only_where_they_are_asked_for() -> None:
    assert set(reached(required(PROJECT, []), INSTALLED)) == {"dask", "numpy", "toolz"}
    plain = {**PROJECT, "project": {**PROJECT["project"], "dependencies": ["dask"]}}
    assert set(reached(required(plain, []), INSTALLED)) == {"dask"}


def test_each_extra_of_this_project_is_reached() -> None:
    extras = project_table()["project"]["optional-dependencies"]
    found = reached(required(project_table(), extras), of_this_interpreter())
    assert {"numpy", "asyncua", "psycopg-binary", "pytest"} <= set(found)
