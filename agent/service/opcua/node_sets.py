"""Import of the node sets of the companion specifications into the server."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Collection, Mapping
from typing import Final
from xml.etree import ElementTree

import structlog
from asyncua import ua
from asyncua.server.server import Server

from agent.errors import EndpointUnavailable
from agent.service.opcua.companion_types import USED_TYPES, CompanionType
from agent.service.opcua.node_set_files import NODE_SETS, XML, NodeSetFile, damaged_node_set, node_sets_to_load
from agent.settings.opcua import OpcUaSettings
from drivers.foreign_errors import IN_THE_LOG

log = structlog.get_logger()

_DECODED: Final = {one.uri: one.decode_values for one in NODE_SETS}
"""Whether the server writes values of the structures of a namespace; only of the namespaces that it needs."""


async def load_node_sets(server: Server, settings: OpcUaSettings, stop: asyncio.Event) -> frozenset[str]:
    """Import the node sets that the settings name, or those that are shipped with the package. Return the URIs of their
    namespaces.

    Raise EndpointUnavailable if the directory or a node set is missing, if a file is damaged or too old, or if `stop`
    is set before the last node set has been imported.
    """
    # asyncua reports peculiarities of the published files, such as nodes with two parents.
    for name in ("asyncua.common.xmlimporter", "asyncua.common.copy_node_util", "asyncua.ua.uatypes"):
        logging.getLogger(name).setLevel(logging.ERROR)
    begun = time.process_time()
    found = node_sets_to_load(settings)
    for file in found.values():
        await asyncio.sleep(0)  # the loop sets `stop` here: the import itself does not give way
        if stop.is_set():
            raise EndpointUnavailable(
                "the server was stopped while it was loading the node sets",
                file=str(file.path), key=file.key, hint="start the service again",
            )  # fmt: skip
        await _import(server, file)
        file.root.clear()
    await require_types(server, found, USED_TYPES)
    log.info("OPC UA node sets loaded", count=len(found), cpu_s=round(time.process_time() - begun, 2))
    return frozenset(found)


async def _import(server: Server, file: NodeSetFile) -> None:
    _remove_unreadable(file.root, further=file.uri not in _DECODED)
    for model in file.root.iterfind(f"{XML}Models/{XML}Model"):
        # They were checked by their versions, apart from that of OPC UA itself; asyncua compares dates of publication,
        # which a file need not state.
        for required in model.findall(f"{XML}RequiredModel"):
            model.remove(required)
    ElementTree.register_namespace("", XML.strip("{}"))
    try:
        text = ElementTree.tostring(file.root, encoding="unicode")
        await server.import_xml(xmlstring=text, auto_load_definitions=_DECODED.get(file.uri, False))
    except Exception as error:
        log.error("node set not imported", file=str(file.path), exc_info=error)
        raise damaged_node_set(file, f"a node of it cannot be imported: {IN_THE_LOG}") from error


def _remove_unreadable(root: ElementTree.Element, *, further: bool) -> None:
    """Remove what asyncua cannot import: nodes that exist only for design tools and have no parent, and default values
    of structures inside of structures. Neither appears in the instances of a type.

    Of a `further` node set remove the default values of all structures that a node set defines: the classes of these
    structures are only made for the namespaces that the server needs.
    """
    for node in list(root):
        value = node.find(f"{XML}Value")
        if node.get("DesignToolOnly") == "true":
            root.remove(node)
        elif value is not None and any(
            _tag(one) == "ExtensionObject" and (_is_nested(one) or (further and _is_of_a_node_set(one)))
            for one in value
        ):
            node.remove(value)


def _is_nested(value: ElementTree.Element) -> bool:
    """Return True if an encoded structure has another encoded structure inside."""
    return sum(_tag(one) == "TypeId" for one in value.iter()) > 1


def _is_of_a_node_set(value: ElementTree.Element) -> bool:
    """Return True if an encoded structure is not one of OPC UA itself."""
    identifiers = ("".join(one.itertext()).strip() for one in value.iter() if _tag(one) == "TypeId")
    return any(identifier.startswith("ns=") for identifier in identifiers)


def _tag(element: ElementTree.Element) -> str:
    return element.tag.rpartition("}")[2]


async def require_types(server: Server, found: Mapping[str, NodeSetFile], types: Collection[CompanionType]) -> None:
    """Raise EndpointUnavailable if one of the `types` whose node set was loaded is not in the address space."""
    for used in types:
        file = found.get(used.namespace)
        if file is None:
            continue
        index = await server.get_namespace_index(used.namespace)
        node = server.get_node(ua.NodeId(ua.Int32(used.number), ua.Int16(index)))
        try:
            name = str((await node.read_browse_name()).Name)
        except ua.UaError:
            name = "nothing"
        if name != used.name:
            raise damaged_node_set(file, f"the type {used.name} (i={used.number}) is missing, {name} is there")
