"""Reading of XML that comes from outside, and the names and places of its elements.

A digital calibration certificate (DCC) is sent by a laboratory, so its text is not trusted: it may have no document
type declaration (and so no entities), nothing is loaded from elsewhere, and size and depth are limited.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

from lxml import etree

from twin.errors import FormatError

DCC: Final = "https://ptb.de/dcc"
"""Namespace of a digital calibration certificate."""
SI: Final = "https://ptb.de/si"
"""Namespace of quantities in D-SI."""
DS: Final = "http://www.w3.org/2000/09/xmldsig#"
"""Namespace of XML signatures."""

MAX_BYTES: Final = 16_000_000
"""Size of the largest certificate. The covariance of 100 balls takes less than 3 MB."""

_LONGEST_QUOTE: Final = 80


def parse_xml(content: bytes, source: str) -> etree._Element:
    """Return the root element of an XML text, without comments and processing instructions.

    Raise FormatError, which names `source` and the line, if the text is too large, is not XML, is nested too deeply, or
    has a document type declaration.
    """
    if len(content) > MAX_BYTES:
        raise FormatError(
            f"the XML file is larger than {MAX_BYTES // 1_000_000} MB",
            hint="Check that this is the right file",
            file=source,
        )
    parser = etree.XMLParser(
        resolve_entities=False,
        load_dtd=False,
        no_network=True,
        huge_tree=False,  # libxml2 then refuses deep nesting and entities that grow
        remove_comments=True,
        remove_pis=True,
    )
    try:
        root = etree.fromstring(content, parser)
    except etree.XMLSyntaxError as error:
        told = str(error.msg)[:_LONGEST_QUOTE]
        raise FormatError(f"this is not valid XML: {told}", file=source, line=error.lineno or 0) from None
    except (ValueError, LookupError) as error:  # LookupError: an unknown encoding
        raise FormatError(f"this is not valid XML: {str(error)[:_LONGEST_QUOTE]}", file=source) from None
    if root is None:
        raise FormatError("the XML file has no element", file=source)
    docinfo: Any = root.getroottree().docinfo  # its stubs leave out the document type
    if docinfo.doctype:
        raise FormatError(
            "the XML file has a document type declaration, which a certificate does not have",
            hint="Ask the laboratory for the certificate as it was issued",
            file=source,
        )
    return root


def local_name(element: etree._Element) -> str:
    """Return the name of an element without its namespace."""
    return str(etree.QName(element).localname)


def is_named(element: etree._Element, namespace: str, *names: str) -> bool:
    """Return True if the element is in the namespace and has one of the names."""
    return element.tag in [f"{{{namespace}}}{name}" for name in names]


def children(element: etree._Element, namespace: str, *names: str) -> list[etree._Element]:
    """Return the children of an element that are in the namespace and have one of the names, in order."""
    return [child for child in element if is_named(child, namespace, *names)]


def child(element: etree._Element, namespace: str, *names: str) -> etree._Element | None:
    """Return the first child of an element that is in the namespace and has one of the names; None if there is none."""
    return next(iter(children(element, namespace, *names)), None)


def required(parent: etree._Element, source: str, *names: str) -> etree._Element:
    """Return the descendant of `parent` that the names lead to, level by level."""
    at = parent
    for name in names:
        found = child(at, DCC, name)
        if found is None:
            raise refused(f"the certificate has no element '{name}' here", at, source)
        at = found
    return at


def text_of(element: etree._Element | None) -> str:
    """Return the text of an element without the white space around it; empty if there is no element or no text."""
    return "" if element is None else (element.text or "").strip()


def path_of(element: etree._Element) -> str:
    """Return the place of an element, such as `/digitalCalibrationCertificate/administrativeData/items/item[2]`. A
    number is given where the parent has several children of the same name."""
    steps: list[str] = []
    at: etree._Element | None = element
    while at is not None:
        parent = at.getparent()
        same = [] if parent is None else [one for one in parent if one.tag == at.tag]
        steps.append(local_name(at) + (f"[{same.index(at) + 1}]" if len(same) > 1 else ""))
        at = parent
    return "/" + "/".join(reversed(steps))


def refused(message: str, element: etree._Element, source: str, hint: str = "") -> FormatError:
    """Return the error of an element, which names the file and the place of the element."""
    return FormatError(message, hint=hint, file=source, element=path_of(element))


def refuse_loose_text(element: etree._Element, source: str) -> None:
    """Raise FormatError if there is text between the children of an element that has only elements."""
    for text in (element.text, *(one.tail for one in element)):
        if text is not None and text.strip():
            shown = " ".join(text.split())[:_LONGEST_QUOTE]
            raise refused(f"the text '{shown}' is not expected here", element, source)


def contents(element: etree._Element | None) -> Iterator[str]:
    """Yield the texts of a name or description (`dcc:content`), English first, then those without a language."""
    if element is None:
        return
    found = [(one.get("lang", ""), " ".join(text_of(one).split())) for one in children(element, DCC, "content")]
    yield from (
        text for _, text in sorted(found, key=lambda one: ("en", "").index(one[0]) if one[0] in ("en", "") else 2)
    )


def text_in_english(element: etree._Element | None) -> str:
    """Return the English text of a name, or else one in any language; empty if there is none."""
    return next((text for text in contents(element) if text), "")
