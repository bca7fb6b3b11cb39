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
MAX_BYTES: Final = 4_000_000
"""Largest size of all node sets together in bytes; those shipped have 1.5 MB. The time in which they are loaded grows
faster than their size: on one core of an x86 PC 1.4 s for those shipped, 8 s for 4 MB and 20 s for 7.5 MB. A computer
that is six times slower still opens 4 MB within `agent.service.opcua.endpoint.OPEN_TIMEOUT_S`."""

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
"""Node sets in the order in which they are imported if none of them builds on a later one."""


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
    size: int = 0
    """Size of the file in bytes."""


def node_sets_to_load(settings: OpcUaSettings) -> Mapping[str, NodeSetFile]:
    """Return the node sets by namespace URI, each after those on which it builds: those of the directory
    ``opcua.node_sets`` or those that are shipped, and the files ``opcua.further_node_sets``.

    Raise EndpointUnavailable if the directory or a node set is missing, if a file is damaged or too old, or if they are
    too large together.
    """
    with as_file(files("agent.service.opcua").joinpath("companion")) as shipped:
        found = dict(read_node_sets(settings.node_sets or shipped))
    size = sum(file.size for file in found.values())
    for path in settings.further_node_sets:
        one = read_node_set(path, FILES_KEY, MAX_BYTES - size)
        size += one.size
        former = found.setdefault(one.uri, one)
        if former is not one:
            hint = "remove one of the two from the settings"
            if former.key == DIRECTORY_KEY:
                hint = "remove this file: the node set of this namespace is there without it"
            raise EndpointUnavailable(
                f"the namespace {one.uri} is also that of {former.path.name}",
                file=str(path), key=FILES_KEY, hint=hint,
            )  # fmt: skip
    return {file.uri: file for file in ordered_node_sets(found)}


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
    found, size = dict[str, NodeSetFile](), 0
    for path in sorted(directory.glob("*.xml")):
        one = read_node_set(path, max_bytes=MAX_BYTES - size)
        size += one.size
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


def ordered_node_sets(found: Mapping[str, NodeSetFile]) -> list[NodeSetFile]:
    """Return the node sets, each after those on which it builds; otherwise those that volcal itself needs come first.
    Raise EndpointUnavailable if one on which another one builds is missing or too old.

    The version of OPC UA itself is not compared: its nodes are those that asyncua brings.
    """
    needed = [node_set.uri for node_set in NODE_SETS]
    left = [found[uri] for uri in (*needed, *(uri for uri in found if uri not in needed))]
    known, ordered = {UA}, list[NodeSetFile]()
    while left:
        ready = next((file for file in left if file.required.keys() <= known), None)
        if ready is None:
            raise _without_its_base(left, found)
        ordered.append(ready)
        known.add(ready.uri)
        left.remove(ready)
    for file in ordered:
        for uri, version in file.required.items():
            if uri in found and _numbers(found[uri].version) < _numbers(version):
                raise EndpointUnavailable(
                    f"the node set {file.uri} needs version {version} of {uri}: {found[uri].version} is there",
                    file=str(file.path), key=file.key, hint=f"replace the older file by a newer one; {DOWNLOAD}",
                )  # fmt: skip
    return ordered


def read_node_set(path: Path, key: str = DIRECTORY_KEY, max_bytes: int = MAX_BYTES) -> NodeSetFile:
    """Read a node set of at most `max_bytes`, which is what is left of MAX_BYTES. Raise EndpointUnavailable if it is
    missing, too large or damaged, or if it is not a node set of a further namespace."""
    try:
        size = path.stat().st_size
        if size > max_bytes:
            raise EndpointUnavailable(
                f"the OPC UA node sets are larger than {MAX_BYTES // 1_000_000} MB together with this one",
                file=str(path), key=key, hint="load only the node sets that the clients of this machine need",
            )  # fmt: skip
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
    return NodeSetFile(path, root, uri, version, _required(path, root, uri, key), key, size)


def _required(path: Path, root: ElementTree.Element, own: str, key: str) -> Mapping[str, str]:
    """Return the namespaces on which the models of a node set build, each with the newest version that one needs. The
    models beside the first, which has the namespace `own`, are in the same file."""
    beside = {model.get("ModelUri", "") for model in root.iterfind(f"{XML}Models/{XML}Model")} - {own}
    required = dict[str, str]()
    for model in root.iterfind(f"{XML}Models/{XML}Model/{XML}RequiredModel"):
        uri, version = model.get("ModelUri", ""), model.get("Version", "")
        if not 0 < len(uri) <= MAX_URI:
            raise _damaged(path, "a model on which it builds has no namespace, or a very long one", key)
        if len(version) > MAX_VERSION:
            raise _damaged(path, f"the version that it needs of {uri} is too long", key)
        if uri not in beside:
            required[uri] = max(required.get(uri, ""), version, key=_numbers)
    return required


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
    """Return the numbers of a version without zeros at its end: 1.02 and 1.02.0 are the same version."""
    numbers = [int(part) for part in version.split(".") if part.isdecimal()]
    while numbers and numbers[-1] == 0:
        numbers.pop()
    return tuple(numbers)
