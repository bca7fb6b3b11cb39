"""Command `make sbom`: bill of materials of what is delivered, in the format CycloneDX 1.6.

    python -m release.sbom [--out dist]

It lists the Python packages at their installed versions, Debian's packages that the package needs, and the node sets of
the OPC Foundation, and which package needs which. The same commit gives the same bytes.

Python packages have their licence and version, node sets their licence and hash. Debian's packages have neither licence
nor version, since Debian delivers them and the computer of the installation determines them. Native libraries inside a
wheel (such as the OpenBLAS of numpy) are not listed one by one; they belong to their Python package.
"""

from __future__ import annotations

import argparse
import re
import sys
import uuid
from collections.abc import Iterable, Iterator, Mapping
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path
from xml.etree import ElementTree

from cyclonedx.model import ExternalReference, ExternalReferenceType, HashAlgorithm, HashType, XsUri
from cyclonedx.model.bom import Bom
from cyclonedx.model.component import Component, ComponentScope, ComponentType
from cyclonedx.model.license import DisjunctiveLicense, LicenseExpression
from cyclonedx.output.json import JsonV1Dot6
from cyclonedx.schema import SchemaVersion
from cyclonedx.validation.json import JsonStrictValidator
from packageurl import PackageURL
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from release.errors import ReleaseRefused
from release.licences import LicenceList, licence_of, read_licence_list
from release.packages import (
    PROJECT,
    ROOT,
    SHIPPED_EXTRAS,
    Installed,
    Package,
    applies,
    direct,
    installed_packages,
    project_table,
    reached,
    reached_extras,
    required,
)
from release.source import commit_time

NODE_SETS = Path("agent/service/opcua/companion")
NODE_SET_LICENCE = "OPC Foundation MIT License 1.00"
NODE_SET_LICENCE_URL = "http://opcfoundation.org/License/MIT/1.00/"
CONTROL = Path("systemd/deb/control")
INTERPRETER, INTERPRETER_PACKAGE = "@PYTHON@", f"python{sys.version_info.major}.{sys.version_info.minor}"
_UA = "{http://opcfoundation.org/UA/2011/03/UANodeSet.xsd}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "dist", help="output directory")
    given = parser.parse_args()
    try:
        path = write_sbom(given.out, installed_packages(), commit_time(ROOT))
    except ReleaseRefused as error:
        print(error, file=sys.stderr)
        return 1
    print(path)
    return 0


def write_sbom(out: Path, installed: Installed, time: int) -> Path:
    """Write the bill of materials to the folder `out` and return its path. `time` is its UTC time in s since 1970.

    Raises ReleaseRefused if a package is missing or its licence is not known.
    """
    requirements = required(project_table(), SHIPPED_EXTRAS)
    text = sbom_text(installed[PROJECT], requirements, reached(requirements, installed), time)
    out.mkdir(parents=True, exist_ok=True)
    path = out / f"{PROJECT}-{installed[PROJECT].version}.cdx.json"
    path.write_text(text, encoding="utf-8")
    return path


def sbom_text(product: Package, requirements: Iterable[Requirement], shipped: Installed, time: int) -> str:
    """Return the bill of materials of `product`, whose `requirements` the packages `shipped` fulfil, as JSON that is
    valid under the schema of CycloneDX. `time` is its UTC time in s since 1970.

    Raises ReleaseRefused if the licence of a package is not known.
    """
    licences = read_licence_list()
    root = _package(product, licences, ComponentType.APPLICATION)
    parts = {name: _package(package, licences, ComponentType.LIBRARY) for name, package in shipped.items()}
    bom = Bom(components=parts.values())
    bom.metadata.component = root
    bom.metadata.timestamp = datetime.fromtimestamp(time, UTC)
    others = [*_node_sets(ROOT / NODE_SETS), *_debian_packages((ROOT / CONTROL).read_text(encoding="utf-8"))]
    bom.components.update(others)
    asked = [one for one in requirements if applies(one, ())]
    bom.register_dependency(root, [*_fulfilling(asked, parts), *others])
    for name, extras in reached_extras(asked, shipped).items():
        bom.register_dependency(parts[name], _fulfilling(direct(shipped[name], extras), parts))
    # A random number would differ from build to build; this one is different if anything that is listed is.
    bom.serial_number = uuid.uuid5(uuid.NAMESPACE_URL, _as_json(bom, uuid.UUID(int=0)))
    text = _as_json(bom, bom.serial_number)
    problem = JsonStrictValidator(SchemaVersion.V1_6).validate_str(text)
    if problem is not None:
        raise ReleaseRefused(f"the bill of materials is not valid under the schema of CycloneDX 1.6: {problem}")
    return text


def _as_json(bom: Bom, number: uuid.UUID) -> str:
    bom.serial_number = number
    return JsonV1Dot6(bom).output_as_string(indent=2) + "\n"


def _package(package: Package, licences: LicenceList, kind: ComponentType) -> Component:
    expression = licence_of(package, licences.stated)
    if expression is None:
        raise ReleaseRefused(f"the licence of {package.name} {package.version} is not known: run `make audit`")
    url = PackageURL("pypi", name=package.name, version=package.version)
    return Component(
        name=package.spelled,
        version=package.version,
        type=kind,
        scope=ComponentScope.REQUIRED,
        bom_ref=str(url),
        purl=url,
        description=package.metadata["Summary"],
        licenses=[LicenseExpression(expression)],
        external_references=_references(package) if kind is ComponentType.LIBRARY else (),
    )


def _references(package: Package) -> Iterator[ExternalReference]:
    """Yield where the package comes from: the page of this version at the public index."""
    page = f"https://pypi.org/project/{package.name}/{package.version}/"
    yield ExternalReference(type=ExternalReferenceType.DISTRIBUTION, url=XsUri(page))


def _fulfilling(requirements: Iterable[Requirement], parts: Mapping[str, Component]) -> list[Component]:
    return [parts[name] for name in sorted({canonicalize_name(one.name) for one in requirements})]


def _node_sets(folder: Path) -> Iterator[Component]:
    """Yield the node sets of the OPC Foundation that the OPC UA server reads, with the hash of each file."""
    for path in sorted(folder.glob("*.xml")):
        model = ElementTree.parse(path).find(f".//{_UA}Models/{_UA}Model")  # noqa: S314  our own tracked file
        if model is None:
            raise ReleaseRefused(f"{path} names no model with its version")
        yield Component(
            name=path.name,
            version=model.get("Version"),
            type=ComponentType.DATA,
            bom_ref=f"file:{path.relative_to(ROOT).as_posix()}",
            description=model.get("ModelUri"),
            licenses=[DisjunctiveLicense(name=NODE_SET_LICENCE, url=XsUri(NODE_SET_LICENCE_URL))],
            hashes=[HashType(alg=HashAlgorithm.SHA_256, content=sha256(path.read_bytes()).hexdigest())],
        )


def _debian_packages(control: str) -> Iterator[Component]:
    """Yield Debian's packages that the package depends on. Their versions are those of the computer on which it is
    installed; a stated one is the oldest that suffices."""
    (line,) = re.findall(r"^Depends: (.+)$", control, re.MULTILINE)
    for entry in line.replace(INTERPRETER, INTERPRETER_PACKAGE).split(", "):
        name, _, versions = entry.partition(" ")
        url = PackageURL("deb", namespace="debian", name=name)
        yield Component(
            name=name,
            type=ComponentType.LIBRARY,
            scope=ComponentScope.REQUIRED,
            bom_ref=str(url),
            purl=url,
            description=f"Debian package {versions.strip('()')}".strip(),
        )


if __name__ == "__main__":
    sys.exit(main())
