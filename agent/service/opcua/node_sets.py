"""Node sets of the companion specifications: the files that are needed, and their import into the server."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path
from typing import Final
from xml.etree import ElementTree

import structlog
from asyncua import ua
from asyncua.server.server import Server

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
    USED_TYPES,
)
from drivers.foreign_errors import IN_THE_LOG, cause_of

XML: Final = "{http://opcfoundation.org/UA/2011/03/UANodeSet.xsd}"
MAX_VERSION: Final = 100
DOWNLOAD: Final = "the node sets are in the repository UA-Nodeset of the OPC Foundation (docs/reference/opc-ua.md)"
log = structlog.get_logger()


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
    path: Path
    root: ElementTree.Element
    uri: str
    version: str
    required: frozenset[str]
    """Namespaces on which the node set builds."""


async def load_node_sets(server: Server, directory: Path | None) -> None:
    """Import the node sets from `directory`, or those that are shipped with the package if it is None. Further node
    sets of the directory, such as that of OPC 40210, follow the needed ones.

    Raise EndpointUnavailable if the directory or a node set is missing, or if a file is damaged or too old.
    """
    # asyncua reports peculiarities of the published files, such as nodes with two parents.
    for name in ("asyncua.common.xmlimporter", "asyncua.common.copy_node_util", "asyncua.ua.uatypes"):
        logging.getLogger(name).setLevel(logging.ERROR)
    begun = time.process_time()
    with as_file(files("agent.service.opcua").joinpath("companion")) as shipped:
        found = read_node_sets(directory or shipped)
    for node_set in NODE_SETS:
        await _import(server, found[node_set.uri], decode_values=node_set.decode_values)
    for file in further_node_sets(found):
        await _import(server, file, decode_values=False)
    await _require_types(server, found)
    log.info("OPC UA node sets loaded", count=len(found), cpu_s=round(time.process_time() - begun, 2))


def read_node_sets(directory: Path) -> Mapping[str, NodeSetFile]:
    """Return the node sets of a directory by namespace URI. Their file names do not matter.

    Every file that ends with ``.xml`` must be a node set, and there must be one for each namespace: which of two is
    loaded is not left to the names of the files.
    """
    if not directory.is_dir():
        raise EndpointUnavailable(
            "the directory of the OPC UA node sets does not exist", file=str(directory), key="opcua.node_sets",
            hint=f"create it and copy the node sets into it, or remove the key to use those shipped; {DOWNLOAD}",
        )  # fmt: skip
    found = dict[str, NodeSetFile]()
    for one in map(_read, sorted(directory.glob("*.xml"))):
        former = found.setdefault(one.uri, one)
        if former is not one:
            raise EndpointUnavailable(
                f"{former.path.name} and {one.path.name} have the same namespace {one.uri}",
                file=str(one.path), key="opcua.node_sets", hint="keep one of the two in the directory",
            )  # fmt: skip
    for node_set in NODE_SETS:
        if node_set.uri not in found:
            raise EndpointUnavailable(
                f"no file here has the namespace {node_set.uri} ({node_set.specification})",
                file=str(directory), key="opcua.node_sets", hint=f"copy its node set into the directory; {DOWNLOAD}",
            )  # fmt: skip
        file = found[node_set.uri]
        if _numbers(file.version) < _numbers(node_set.version):
            raise EndpointUnavailable(
                f"version {file.version} of {node_set.uri} is too old: at least {node_set.version} is needed",
                file=str(file.path), key="opcua.node_sets", hint=f"replace the file by a newer one; {DOWNLOAD}",
            )  # fmt: skip
    return found


def further_node_sets(found: Mapping[str, NodeSetFile]) -> list[NodeSetFile]:
    """Return the node sets that volcal itself does not need, each after those on which it builds. Raise
    EndpointUnavailable if one of these is missing."""
    known = {UA, *(node_set.uri for node_set in NODE_SETS)}
    left, ordered = [file for uri, file in found.items() if uri not in known], list[NodeSetFile]()
    while left:
        ready = [file for file in left if file.required <= known]
        if not ready:
            file = left[0]
            raise EndpointUnavailable(
                f"the node set {file.uri} builds on {', '.join(sorted(file.required - known))}, which is not here",
                file=str(file.path), key="opcua.node_sets", hint=f"copy the missing node set too; {DOWNLOAD}",
            )  # fmt: skip
        ordered += ready
        known |= {file.uri for file in ready}
        left = [file for file in left if file not in ready]
    return ordered


def _read(path: Path) -> NodeSetFile:
    try:
        root = ElementTree.parse(path).getroot()  # noqa: S314  a file that the administrator of this computer chose
    except ElementTree.ParseError as error:
        raise _damaged(path, f"it is not XML in line {error.position[0]}") from error
    except (OSError, ValueError, LookupError) as error:  # LookupError: an unknown encoding
        raise _damaged(path, cause_of(error)) from error
    model = root.find(f"{XML}Models/{XML}Model")
    if root.tag != f"{XML}UANodeSet" or model is None:
        raise _damaged(path, "it is not a UANodeSet with a model")
    version = model.get("Version", "")
    if len(version) > MAX_VERSION:
        raise _damaged(path, "the version of its model is too long")
    required = frozenset(one.get("ModelUri", "") for one in model.iterfind(f"{XML}RequiredModel"))
    return NodeSetFile(path, root, model.get("ModelUri", ""), version, required)


def _damaged(path: Path, reason: object) -> EndpointUnavailable:
    return EndpointUnavailable(
        f"the OPC UA node set cannot be read: {reason}", file=str(path), key="opcua.node_sets",
        hint=f"copy the file again; {DOWNLOAD}",
    )  # fmt: skip


def _numbers(version: str) -> tuple[int, ...]:
    return tuple(int(part) for part in version.split(".") if part.isdecimal())


async def _import(server: Server, file: NodeSetFile, *, decode_values: bool) -> None:
    _remove_unreadable(file.root)
    ElementTree.register_namespace("", XML.strip("{}"))
    try:
        text = ElementTree.tostring(file.root, encoding="unicode")
        await server.import_xml(xmlstring=text, auto_load_definitions=decode_values)
    except Exception as error:
        log.error("node set not imported", file=str(file.path), exc_info=error)
        raise _damaged(file.path, f"a node of it cannot be imported: {IN_THE_LOG}") from error


def _remove_unreadable(root: ElementTree.Element) -> None:
    """Remove what asyncua cannot import: nodes that exist only for design tools and have no parent, and default values
    of structures inside of structures. Neither appears in the instances of a type."""
    for node in list(root):
        value = node.find(f"{XML}Value")
        if node.get("DesignToolOnly") == "true":
            root.remove(node)
        elif value is not None and any(_tag(one) == "ExtensionObject" and _is_nested(one) for one in value):
            node.remove(value)


def _is_nested(value: ElementTree.Element) -> bool:
    """Return True if an encoded structure has another encoded structure inside."""
    return sum(_tag(one) == "TypeId" for one in value.iter()) > 1


def _tag(element: ElementTree.Element) -> str:
    return element.tag.rpartition("}")[2]


async def _require_types(server: Server, found: Mapping[str, NodeSetFile]) -> None:
    """Raise EndpointUnavailable if a type that is used here is not in the address space."""
    for used in USED_TYPES:
        index = await server.get_namespace_index(used.namespace)
        node = server.get_node(ua.NodeId(ua.Int32(used.number), ua.Int16(index)))
        try:
            name = str((await node.read_browse_name()).Name)
        except ua.UaError:
            name = "nothing"
        if name != used.name:
            file = found[used.namespace].path
            raise _damaged(file, f"the type {used.name} (i={used.number}) is missing, {name} is there")
