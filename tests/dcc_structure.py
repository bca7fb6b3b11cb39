"""Structure of a digital calibration certificate (schema 3.3.0) and of D-SI (2.2), written down by hand from their
published documentation: which children an element has, in which order and how often, and what its text may be.

This is no replacement of the schema itself: it knows only the elements that volcal writes.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from lxml import etree

DCC, SI, DS = "https://ptb.de/dcc", "https://ptb.de/si", "http://www.w3.org/2000/09/xmldsig#"
ANY_ORDER = "any order: "

CHILDREN = {
    "digitalCalibrationCertificate": "administrativeData measurementResults comment? document? Signature*",
    # since 3.0 the parts may stand in any order, each once
    "administrativeData": ANY_ORDER
    + "dccSoftware refTypeDefinitions? coreData items calibrationLaboratory respPersons customer statements?",
    "dccSoftware": "software+",
    "usedSoftware": "software+",
    "software": "name release type? description?",
    "refTypeDefinitions": "refTypeDefinition+",
    "refTypeDefinition": "name description? namespace link release? value? procedure?",
    "coreData": "countryCodeISO3166_1 usedLangCodeISO639_1+ mandatoryLangCodeISO639_1+ uniqueIdentifier "
    "identifications? receiptDate? beginPerformanceDate endPerformanceDate performanceLocation issueDate? "
    "reportAmendedSubstituted? previousReport?",
    "identifications": "identification+",
    "identification": "issuer value name?",
    "items": "name? equipmentClass* description? owner? manufacturer? identifications? item+",
    "item": "name equipmentClass* description? owner? installedSoftwares? manufacturer? model? identifications "
    "itemQuantities? subItems?",
    "manufacturer": "name eMail? phone? fax? link? location? descriptionData?",
    "person": "name eMail? phone? fax? link? location? descriptionData?",
    "contact": "name eMail? phone? fax? link? location descriptionData?",
    "customer": "name eMail? phone? fax? link? location descriptionData?",
    "location": "(city|countryCode|postCode|postOfficeBox|state|street|streetNo|further|positionCoordinates)+",
    "calibrationLaboratory": "calibrationLaboratoryCode? contact cryptElectronicSeal? cryptElectronicSignature? "
    "cryptElectronicTimeStamp?",
    "respPersons": "respPerson+",
    "respPerson": "person description? role? mainSigner? cryptElectronicSeal? cryptElectronicSignature? "
    "cryptElectronicTimeStamp?",
    "statements": "statement+",
    "statement": "name? description? countryCodeISO3166_1* convention? traceable? norm* reference* link* declaration? "
    "(valid|validXMLList)? date? period? respAuthority? (conformity|conformityXMLList)? data? nonSIDefinition? "
    "nonSIUnit? location?",
    "measurementResults": "usedMethods? usedSoftware? measuringEquipments? influenceConditions? measurementMetaData? "
    "measurementResult+",
    "measurementResult": "name description? usedMethods? usedSoftware? measuringEquipments? influenceConditions? "
    "results measurementMetaData?",
    "usedMethods": "usedMethod+",
    "usedMethod": "name description? norm* reference* link* usedMethodQuantities?",
    "measuringEquipments": "name? equipmentClass* description? owner? identifications? measuringEquipment+",
    "measuringEquipment": "name equipmentClass* description? certificate? manufacturer? model? identifications? "
    "measuringEquipmentQuantities? installedSoftware?",
    "influenceConditions": "influenceCondition+",
    "influenceCondition": "name description? status? certificate? data",
    "results": "result+",
    "result": "name description? data",
    "data": "(text|formula|byteData|xml|quantity|list)+",
    "list": "name? description? (dateTime|dateTimeXMLList)? (list|quantity)+ usedMethods? usedSoftware? "
    "measuringEquipments? influenceConditions? measurementMetaData?",
    "quantity": "name? description? (noQuantity|charsXMLList|real|list|hybrid|complex|constant|realListXMLList|"
    "complexListXMLList) relativeUncertainty? usedMethods? usedSoftware? measuringEquipments? influenceConditions? "
    "measurementMetaData?",
    "measurementMetaData": "metaData+",
    "name": "content+",
    "description": "name? (content|file|formula)*",
    "declaration": "name? (content|file|formula)*",
    "further": "name? (content|file|formula)*",
    "document": "name? description? fileName mimeType dataBase64",
    # D-SI
    "real": "label? quantityTypeQUDT? value unit significantDigit? dateTime? "
    "(measurementUncertaintyUnivariate|expandedUnc|coverageInterval)?",
    "measurementUncertaintyUnivariate": "(standardMU|expandedMU|coverageIntervalMU)",
    "expandedMU": "valueExpandedMU coverageFactor coverageProbability distribution?",
    "coverageIntervalMU": "valueStandardMU intervalMin intervalMax coverageProbability distribution?",
}
CHILDREN["metaData"] = CHILDREN["statement"]

NOT_EMPTY = r"\S+(\s+\S+)*"
DECIMAL = r"[-+]?((\d*\.\d+)|(\d+\.\d*)|(\d+))([Ee][-+]?\d+)?"
NOT_NEGATIVE = DECIMAL.replace("[-+]?(", r"\+?(", 1)
DATE = r"\d{4}-\d{2}-\d{2}"
TEXTS = {
    "content": r"(?s).*\S.*",
    "countryCodeISO3166_1": "[A-Z]{2}",
    "countryCode": "[A-Z]{2}",
    "usedLangCodeISO639_1": "[a-z]{2}",
    "mandatoryLangCodeISO639_1": "[a-z]{2}",
    "beginPerformanceDate": DATE,
    "endPerformanceDate": DATE,
    "issueDate": DATE,
    "performanceLocation": "laboratory|customer|laboratoryBranch|customerBranch|other",
    "issuer": "manufacturer|calibrationLaboratory|customer|owner|other",
    "conformity": "pass|fail|conditionalPass|conditionalFail|noPass|noFail",
    "mainSigner": "true|false",
    "type": "application|bios|driver|editor|firmware|library|os|other",
    "dataBase64": r"[A-Za-z0-9+/]+={0,2}",
    "valueExpandedMU": NOT_NEGATIVE,
    "valueStandardMU": NOT_NEGATIVE,
    "intervalMin": DECIMAL,
    "intervalMax": DECIMAL,
    "coverageFactor": r"[1-9]\d*(\.\d*)?",
    "coverageProbability": r"0(\.\d*)?|1(\.0*)?",
    "unit": r"(\\[a-z]+(\{-?\d+\})?)+",
}
ATTRIBUTES = {
    "digitalCalibrationCertificate": {"schemaVersion", "{http://www.w3.org/2001/XMLSchema-instance}schemaLocation"},
    "content": {"lang"},
}


def complaints(root: etree._Element) -> Iterator[str]:
    """Yield what is wrong with the structure of a certificate."""
    if root.tag != f"{{{DCC}}}digitalCalibrationCertificate" or root.get("schemaVersion") != "3.3.0":
        yield "the root is not that of a certificate of schema 3.3.0"
    yield from _of(root, "")


def _of(element: etree._Element, above: str) -> Iterator[str]:
    name = etree.QName(element).localname
    path = f"{above}/{name}"
    namespace = etree.QName(element).namespace
    if namespace == DS:
        return  # checked by the schema of the signature itself
    allowed = {"id", "refId", "refType"} | ATTRIBUTES.get(name, set())
    yield from (f"{path}: attribute {one!r}" for one in element.attrib if one not in allowed)
    if "refType" in element.attrib and not element.get("refType", "").split():
        yield f"{path}: empty refType"
    in_si = namespace == SI
    expects_si = above.rsplit("/", 1)[-1] in (
        "real",
        "expandedMU",
        "coverageIntervalMU",
        "measurementUncertaintyUnivariate",
    )
    if in_si != (expects_si or name == "real"):
        yield f"{path}: namespace {namespace!r}"
    children = [etree.QName(child).localname for child in element]
    if name not in CHILDREN:
        text = element.text or ""
        if children:
            yield f"{path}: children {children}"
        pattern = DECIMAL if in_si and name == "value" else TEXTS.get(name, NOT_EMPTY)
        if re.fullmatch(pattern, text) is None:
            yield f"{path}: text {text[:60]!r}"
        return
    model = CHILDREN[name]
    if (element.text or "").strip():
        yield f"{path}: text beside children"
    if model.startswith(ANY_ORDER):
        parts = model.removeprefix(ANY_ORDER).split()
        needed = [part for part in parts if not part.endswith("?")]
        known = {part.rstrip("?") for part in parts}
        if set(needed) - set(children) or set(children) - known or len(set(children)) != len(children):
            yield f"{path}: children {children}"
    elif re.fullmatch(_pattern(model), "".join(f"{child} " for child in children)) is None:
        yield f"{path}: children {children}"
    for child in element:
        yield from _of(child, path)


def _pattern(model: str) -> str:
    """Return the regular expression of the names of children, each followed by a blank."""
    parts = []
    for part in re.findall(r"(?:\([^)]*\)|\w+)[?*+]?", model):
        names, often = (part[:-1], part[-1]) if part[-1] in "?*+" else (part, "")
        alternatives = names.strip("()").replace(" ", "").split("|")
        parts.append(f"(?:{'|'.join(f'{one} ' for one in alternatives)}){often}")
    return "".join(parts)
