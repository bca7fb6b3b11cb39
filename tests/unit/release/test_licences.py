"""A licence is known only if it is stated without doubt, and allowed only if it is in the list."""

from __future__ import annotations

from pathlib import Path

import pytest
from stated_packages import environment, of_this_interpreter, package

from release.audit import findings
from release.licences import LicenceList, StatedLicence, audit_licences, is_allowed, licence_of, normalized
from release.licences import read_licence_list as listed

OSI = "License :: OSI Approved :: "
ALLOWED = LicenceList(frozenset({"MIT", "BSD-3-Clause"}), frozenset({"MIT", "BSD-3-Clause", "GPL-3.0-only"}), {})


@pytest.mark.parametrize(
    ("headers", "expression"),
    [
        ({"License_Expression": "MIT OR Apache-2.0", "License": "GPL-3.0-only"}, "MIT OR Apache-2.0"),
        ({"License": "bsd-3-clause", "Classifier": [f"{OSI}BSD License"]}, "BSD-3-Clause"),
        ({"Classifier": [f"{OSI}MIT License", "Topic :: Utilities"]}, "MIT"),
        ({"Classifier": ["License :: OSI Approved", f"{OSI}Apache Software License"]}, "Apache-2.0"),
        ({"License": "UNKNOWN", "Classifier": [f"{OSI}ISC License (ISCL)"]}, "ISC"),
        ({"License": "BSD"}, None),
        ({"License": "BSD 3-Clause License"}, None),
        ({"License": "MIT\nand a long text"}, None),
        ({"Classifier": [f"{OSI}BSD License"]}, None),
        ({"Classifier": [f"{OSI}MIT License", f"{OSI}GNU General Public License v2 or later (GPLv2+)"]}, None),
        ({"License_Expression": "LicenseRef-Ours"}, None),
        ({}, None),
    ],
)
def test_only_one_licence_without_doubt_is_taken(headers: dict[str, str | list[str]], expression: str | None) -> None:
    assert licence_of(package("some", "1.0", **headers), {}) == expression


def test_a_stated_licence_is_that_of_one_version() -> None:
    stated = {"some": StatedLicence("1.0", "BSD-3-Clause")}
    assert licence_of(package("some", "1.0", License="BSD"), stated) == "BSD-3-Clause"
    assert licence_of(package("some", "1.1", License="MIT"), stated) is None


@pytest.mark.parametrize(
    ("expression", "allowed"),
    [
        ("MIT", True),
        ("MIT AND BSD-3-Clause", True),
        ("MIT AND GPL-3.0-only", False),
        ("MIT OR GPL-3.0-only", True),
        ("(MIT OR GPL-3.0-only) AND (BSD-3-Clause OR AGPL-3.0-only)", True),
        ("(MIT OR GPL-3.0-only) AND AGPL-3.0-only", False),
        ("GPL-3.0-only", False),
        ("GPL-3.0-or-later WITH GCC-exception-3.1", False),
    ],
)
def test_all_parts_of_a_conjunction_and_one_of_an_alternative(expression: str, allowed: bool) -> None:
    assert is_allowed(expression, ALLOWED.shipped) is allowed


def test_an_exception_is_allowed_only_together_with_its_licence() -> None:
    expression = "GPL-3.0-or-later WITH GCC-exception-3.1"
    assert is_allowed(expression, {expression})
    assert not is_allowed("GPL-3.0-or-later", {expression})


def test_unknown_and_forbidden_licences_are_found() -> None:
    installed = environment(
        package("copyleft", "1.0", License_Expression="GPL-3.0-only"),
        package("network", "2.0", License_Expression="AGPL-3.0-only"),
        package("silent", "3.0", Classifier=[f"{OSI}BSD License"]),
        package("volcal", "0.1.0"),
    )
    found = audit_licences(installed, {"silent"}, ALLOWED)
    assert [text.split(";")[0] for text in found] == [
        "network 2.0 is used in development, but AGPL-3.0-only is not allowed",
        "silent 3.0: its metadata state no SPDX licence (BSD License)",
    ]
    assert audit_licences(installed, {"copyleft"}, ALLOWED)[0].startswith("copyleft 1.0 is shipped, but GPL-3.0-only")


def test_a_stated_licence_without_its_package_or_its_version_is_found() -> None:
    stated = {
        "gone": StatedLicence("1.0", "MIT"),
        "newer": StatedLicence("1.0", "MIT"),
        "wrong": StatedLicence("1.0", "BSD"),
    }
    installed = environment(package("newer", "2.0", License="MIT"), package("wrong", "1.0"))
    found = audit_licences(installed, {}, LicenceList(ALLOWED.shipped, ALLOWED.development, stated))
    for text in (
        "release/licences.toml: gone is not installed; remove the entry",
        "release/licences.toml: the licence of newer was read for 1.0, not for 2.0",
        "release/licences.toml: wrong: `BSD` is not an SPDX expression",
    ):
        assert text in found


def test_every_allowed_identifier_is_one_of_spdx() -> None:
    licences = listed()
    assert [one for one in licences.development if normalized(one) != one] == []
    assert licences.shipped <= licences.development
    assert not {one for one in licences.shipped if one.startswith(("AGPL", "SSPL"))}


def test_this_environment_passes_the_audit() -> None:
    assert findings(of_this_interpreter()) == []


def test_a_licence_list_is_read_from_its_file(tmp_path: Path) -> None:
    path = tmp_path / "licences.toml"
    path.write_text(
        '[allowed]\nshipped = ["MIT"]\ndevelopment = ["GPL-3.0-only"]\n'
        '[stated]\nsome = { version = "1.0", expression = "MIT" }\n'
    )
    assert listed(path) == LicenceList(
        frozenset({"MIT"}), frozenset({"MIT", "GPL-3.0-only"}), {"some": StatedLicence("1.0", "MIT")}
    )
