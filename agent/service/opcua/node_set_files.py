"""Node sets of the companion specifications as files: which are needed, and whether they can be loaded.

This module does without asyncua, so that `volcal config check` says what is wrong before the server is opened.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path
from typing import Final
from xml.etree import ElementTree

from agent.errors import EndpointUnavailable
from agent.service.opcua.companion_types import (
    DEVICES,
    INDUSTRIAL_AUTOMATION,
    JOB_CONTROL,
    JOBS,
    MACHINE_TOOL,
    MACHINERY,
    RESULT,
    UA,
)
from agent.service.opcua.model import NAMESPACE
from agent.settings.opcua import OpcUaSettings
from drivers.foreign_errors import cause_of

XML: Final = "{http://opcfoundation.org/UA/2011/03/UANodeSet.xsd}"
MAX_VERSION: Final = 100
MAX_URI: Final = 300
MAX_BYTES: Final = 32_000_000
"""Largest node set in bytes. The largest one that the OPC Foundation publishes is that of OPC UA itself, with 8 MB."""

DIRECTORY_KEY, FILES_KEY = "opcua.node_sets", "opcua.further_node_sets"
DOWNLOAD: Final = "the node sets are in the repository UA-Nodeset of the OPC Foundation (docs/reference/opc-ua.md)"


@dataclass(frozen=True)
class NodeSet:
    """Node set of a companion specification. `version` is the oldest version that has all types used here; the OPC
    Foundation only extends a namespace under the same URI."""

    specification: str
    uri: str
    version: str
    decode_values: bool = False
    """True if the server itself writes values of the structures that the node set defines."""


NODE_SETS: Final = (
    NodeSet("OPC 10000-100 Devices", DEVICES, "1.04.0"),
    NodeSet("OPC 10000-200 Industrial Automation", INDUSTRIAL_AUTOMATION, "1.01.2"),
    NodeSet("OPC 40001-1 Machinery", MACHINERY, "1.03.0"),
    NodeSet("OPC 10031-4 ISA-95 Job Control", JOB_CONTROL, "2.0.0"),
    NodeSet("OPC 40001-3 Machinery Job Management", JOBS, "1.0.1"),
    NodeSet("OPC 40501-1 Machine Tools", MACHINE_TOOL, "1.02.0"),
    NodeSet("OPC 40001-101 Machinery Result Transfer", RESULT, "1.01.0", decode_values=True),
)
"""Node sets in the order in which they must be imported."""


@dataclass(frozen=True)
class NodeSetFile:
    """File of a node set. `key` is the key of the settings that names it."""

    path: Path
    root: ElementTree.Element
    uri: str
    version: str
    required: Mapping[str, str]
    """Namespaces on which the node set builds, each with the version that it needs at least; empty if it says none."""
    key: str = DIRECTORY_KEY


def node_sets_to_load(settings: OpcUaSettings) -> Mapping[str, NodeSetFile]:
    """Return the node sets by namespace URI, each after those on which it builds: those of the directory
    ``opcua.node_sets`` or those that are shipped, and the files ``opcua.further_node_sets``.

    Raise EndpointUnavailable if the directory or a node set is missing, or if a file is damaged, too large or too old.
    """
    with as_file(files("agent.service.opcua").joinpath("companion")) as shipped:
        found = dict(read_node_sets(settings.node_sets or shipped))
    for path in settings.further_node_sets:
        one = read_node_set(path, FILES_KEY)
        former = found.setdefault(one.uri, one)
        if former is not one:
            hint = "remove one of the two from the settings"
            if former.key == DIRECTORY_KEY:
                hint = "remove this file: the node set of this namespace is there without it"
            raise EndpointUnavailable(
                f"the namespace {one.uri} is also that of {former.path.name}",
                file=str(path), key=FILES_KEY, hint=hint,
            )  # fmt: skip
    needed = [found[node_set.uri] for node_set in NODE_SETS]
    return {file.uri: file for file in (*needed, *further_node_sets(found))}


def read_node_sets(directory: Path) -> Mapping[str, NodeSetFile]:
    """Return the node sets of a directory by namespace URI. Their file names do not matter.

    Every file that ends with ``.xml`` must be a node set, and there must be one for each namespace: which of two is
    loaded is not left to the names of the files.
    """
    if not directory.is_dir():
        raise EndpointUnavailable(
            "the directory of the OPC UA node sets does not exist", file=str(directory), key=DIRECTORY_KEY,
            hint=f"create it and copy the node sets into it, or remove the key to use those shipped; {DOWNLOAD}",
        )  # fmt: skip
    found = dict[str, NodeSetFile]()
    for one in map(read_node_set, sorted(directory.glob("*.xml"))):
        former = found.setdefault(one.uri, one)
        if former is not one:
            raise EndpointUnavailable(
                f"{former.path.name} and {one.path.name} have the same namespace {one.uri}",
                file=str(one.path), key=DIRECTORY_KEY, hint="keep one of the two in the directory",
            )  # fmt: skip
    for node_set in NODE_SETS:
        if node_set.uri not in found:
            raise EndpointUnavailable(
                f"no file here has the namespace {node_set.uri} ({node_set.specification})",
                file=str(directory), key=DIRECTORY_KEY, hint=f"copy its node set into the directory; {DOWNLOAD}",
            )  # fmt: skip
        _require_version(found[node_set.uri], node_set.version)
    return found


def further_node_sets(found: Mapping[str, NodeSetFile]) -> list[NodeSetFile]:
    """Return the node sets that volcal itself does not need, each after those on which it builds. Raise
    EndpointUnavailable if one of these is missing or too old."""
    known = {UA, *(node_set.uri for node_set in NODE_SETS)}
    left, ordered = [file for uri, file in found.items() if uri not in known], list[NodeSetFile]()
    while left:
        ready = [file for file in left if file.required.keys() <= known]
        if not ready:
            raise _without_its_base(left, found)
        ordered += ready
        known |= {file.uri for file in ready}
        left = [file for file in left if file not in ready]
    for file in ordered:
        for uri, version in file.required.items():
            if uri in found and _numbers(found[uri].version) < _numbers(version):
                raise EndpointUnavailable(
                    f"the node set {file.uri} needs version {version} of {uri}: {found[uri].version} is there",
                    file=str(file.path), key=file.key, hint=f"replace the older file by a newer one; {DOWNLOAD}",
                )  # fmt: skip
    return ordered


def read_node_set(path: Path, key: str = DIRECTORY_KEY) -> NodeSetFile:
    """Read a node set. Raise EndpointUnavailable if it is missing, too large or damaged, or if it is not a node set of
    a further namespace."""
    try:
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise _damaged(path, f"it is larger than {MAX_BYTES // 1_000_000} MB", key)
        root = ElementTree.parse(path).getroot()  # noqa: S314  a file that the administrator of this computer chose
    except FileNotFoundError:
        raise EndpointUnavailable(
            "there is no such OPC UA node set", file=str(path), key=key, hint=f"copy it there; {DOWNLOAD}"
        ) from None
    except ElementTree.ParseError as error:
        raise _damaged(path, f"it is not XML in line {error.position[0]}", key) from error
    except (OSError, ValueError, LookupError) as error:  # LookupError: an unknown encoding
        raise _damaged(path, cause_of(error), key) from error
    model = root.find(f"{XML}Models/{XML}Model")
    if root.tag != f"{XML}UANodeSet" or model is None:
        raise _damaged(path, "it is not a UANodeSet with a model", key)
    uri, version = model.get("ModelUri", ""), model.get("Version", "")
    if len(version) > MAX_VERSION:
        raise _damaged(path, "the version of its model is too long", key)
    if not 0 < len(uri) <= MAX_URI:
        raise _damaged(path, "its model has no namespace, or a very long one", key)
    if uri in (UA, NAMESPACE):
        raise _damaged(path, f"its namespace {uri} is part of the server itself", key)
    if uri not in {one.text for one in root.iterfind(f"{XML}NamespaceUris/{XML}Uri")}:
        raise _damaged(path, f"the namespace {uri} of its model is not one of its NamespaceUris", key)
    required = {one.get("ModelUri", ""): one.get("Version", "") for one in model.iterfind(f"{XML}RequiredModel")}
    return NodeSetFile(path, root, uri, version, required, key)


def damaged_node_set(file: NodeSetFile, reason: object) -> EndpointUnavailable:
    """Return the error that says why a node set cannot be used."""
    return _damaged(file.path, reason, file.key)


def _damaged(path: Path, reason: object, key: str) -> EndpointUnavailable:
    return EndpointUnavailable(
        f"the OPC UA node set cannot be read: {reason}",
        file=str(path),
        key=key,
        hint=f"copy the file again; {DOWNLOAD}",
    )


def _require_version(file: NodeSetFile, version: str) -> None:
    if _numbers(file.version) < _numbers(version):
        raise EndpointUnavailable(
            f"version {file.version} of {file.uri} is too old: at least {version} is needed",
            file=str(file.path), key=file.key, hint=f"replace the file by a newer one; {DOWNLOAD}",
        )  # fmt: skip


def _without_its_base(left: Sequence[NodeSetFile], found: Iterable[str]) -> EndpointUnavailable:
    """Return the error about the first of the node sets `left` whose base is missing, not only left as well."""
    known = {UA, *found}
    file = next((one for one in left if one.required.keys() - known), left[0])
    missing = sorted(file.required.keys() - known)
    if not missing:
        return damaged_node_set(file, "it builds on itself, or on a node set that builds on it")
    return EndpointUnavailable(
        f"the node set {file.uri} builds on {', '.join(missing)}, which is not here",
        file=str(file.path), key=file.key,
        hint=f"add the missing node set to the setting too; {DOWNLOAD}" if file.key == FILES_KEY
        else f"copy the missing node set too; {DOWNLOAD}",
    )  # fmt: skip


def _numbers(version: str) -> tuple[int, ...]:
    return tuple(int(part) for part in version.split(".") if part.isdecimal())
