"""Small node sets of OPC 40210 and OPC 40505, written from the tables of the documents for these tests: the types that
volcal uses, with their published identifiers, and what is mandatory in them.

The published node sets are not part of the repository; the identifiers of the declarations inside of the types are not
theirs.
"""

from __future__ import annotations

from pathlib import Path
from xml.sax.saxutils import quoteattr

GMS = "http://opcfoundation.org/UA/GMS/"
WMTP = "http://opcfoundation.org/UA/WMTP/"
RESULT = "http://opcfoundation.org/UA/Machinery/Result/"
MACHINE_TOOL = "http://opcfoundation.org/UA/MachineTool/"
DI = "http://opcfoundation.org/UA/DI/"
MACHINERY = "http://opcfoundation.org/UA/Machinery/"

MANDATORY, OPTIONAL = "i=78", "i=80"
FOLDER, OBJECT, VARIABLE, PROPERTY = "i=61", "i=58", "i=63", "i=68"
ALIASES = {
    "HasModellingRule": "i=37",
    "HasTypeDefinition": "i=40",
    "HasSubtype": "i=45",
    "HasProperty": "i=46",
    "HasComponent": "i=47",
    "HasAddIn": "i=17604",
}
HAS_SUBTYPE, HAS_PROPERTY, HAS_COMPONENT, HAS_ADD_IN = "HasSubtype", "HasProperty", "HasComponent", "HasAddIn"

BOOLEAN, UINT16, UINT32, STRING, NODE_ID, TEXT, UINTEGER = (f"i={n}" for n in (1, 5, 7, 12, 17, 21, 28))
DURATION, UTC_TIME, ENUMERATION = "i=290", "i=294", "i=29"

# number, name, the type above; of a variable type also its data type
GMS_TYPES = (
    ("UADataType", 3002, "ToolIsQualifiedStatus", ENUMERATION, ""),
    ("UADataType", 3004, "ToolAlignmentState", ENUMERATION, ""),
    ("UADataType", 3009, "MeasurementReasonEnum", ENUMERATION, ""),
    ("UAVariableType", 2004, "GMSResultType", "ns=2;i=2001", "ns=2;i=3008"),
    ("UAObjectType", 1003, "GMSEquipmentType", "ns=3;i=12", ""),
    ("UAObjectType", 1011, "GMSIdentificationType", "ns=3;i=11", ""),
    ("UAObjectType", 1004, "GMSMonitoringType", "ns=3;i=14", ""),
    ("UAObjectType", 1008, "GMSResultManagementType", "ns=2;i=1004", ""),
    ("UAObjectType", 1002, "GMSType", "ns=3;i=13", ""),
    ("UAObjectType", 1007, "SensorType", "ns=3;i=50", ""),
    ("UAObjectType", 1006, "ToolMonitoringType", "ns=3;i=41", ""),
    ("UAObjectType", 1019, "CalibrationPrognosisType", "ns=3;i=3", ""),
    ("UAObjectType", 1016, "GMSJobType", "ns=3;i=29", ""),
)
# number, the node above, reference, browse name, type definition, modelling rule; of a variable also its data type
GMS_DECLARATIONS = (
    (1, 1002, HAS_COMPONENT, "3:Equipment", "ns=1;i=1003", MANDATORY, ""),
    (2, 1, HAS_COMPONENT, "3:Tools", "ns=3;i=44", OPTIONAL, ""),
    (3, 1002, HAS_ADD_IN, "4:Identification", "ns=1;i=1011", MANDATORY, ""),
    (4, 3, HAS_PROPERTY, "4:Manufacturer", PROPERTY, MANDATORY, TEXT),
    (5, 3, HAS_PROPERTY, "4:ProductInstanceUri", PROPERTY, MANDATORY, STRING),
    (6, 3, HAS_PROPERTY, "4:SerialNumber", PROPERTY, MANDATORY, STRING),
    (7, 1002, HAS_COMPONENT, "3:Monitoring", "ns=1;i=1004", MANDATORY, ""),
    (8, 7, HAS_COMPONENT, "3:MachineTool", "ns=3;i=26", MANDATORY, ""),
    (9, 8, HAS_COMPONENT, "3:OperationMode", VARIABLE, MANDATORY, "ns=3;i=65"),
    (10, 1002, HAS_COMPONENT, "3:Notification", "ns=3;i=7", MANDATORY, ""),
    (11, 10, HAS_COMPONENT, "3:Prognoses", "ns=3;i=2", OPTIONAL, ""),
    (12, 1002, HAS_COMPONENT, "3:Production", "ns=3;i=21", MANDATORY, ""),
    (13, 12, HAS_COMPONENT, "3:ActiveProgram", "ns=3;i=32", MANDATORY, ""),
    (14, 13, HAS_PROPERTY, "3:Name", PROPERTY, MANDATORY, STRING),
    (15, 13, HAS_PROPERTY, "NumberInList", PROPERTY, MANDATORY, UINT16),
    (16, 13, HAS_COMPONENT, "3:State", "ns=3;i=15", MANDATORY, ""),
    (17, 16, HAS_COMPONENT, "CurrentState", "i=2760", MANDATORY, TEXT),
    (18, 17, HAS_PROPERTY, "Id", PROPERTY, MANDATORY, NODE_ID),
    (19, 17, HAS_PROPERTY, "Number", PROPERTY, MANDATORY, UINT32),
    (20, 1002, HAS_COMPONENT, "1:ResultManagement", "ns=1;i=1008", MANDATORY, ""),
    (21, 20, HAS_COMPONENT, "2:Results", FOLDER, OPTIONAL, ""),
    (22, 21, HAS_COMPONENT, "2:ResultVariable", "ns=2;i=2001", "i=11508", "ns=2;i=3008"),
    (23, 1007, HAS_COMPONENT, "1:Class", "i=2376", MANDATORY, UINTEGER),
    (24, 23, HAS_PROPERTY, "EnumStrings", PROPERTY, MANDATORY, TEXT),
    (25, 1007, HAS_COMPONENT, "3:ToolLife", OBJECT, MANDATORY, ""),
    (26, 1007, HAS_PROPERTY, "1:IsQualifiedStatus", PROPERTY, OPTIONAL, "ns=1;i=3002"),
    (27, 1006, HAS_PROPERTY, "1:ActiveTool", PROPERTY, OPTIONAL, NODE_ID),
    (28, 1019, HAS_PROPERTY, "1:Calibrated", PROPERTY, MANDATORY, BOOLEAN),
    (29, 1019, HAS_PROPERTY, "1:DateOfCalibration", PROPERTY, MANDATORY, UTC_TIME),
    (30, 1019, HAS_PROPERTY, "1:CalibrationInterval", PROPERTY, OPTIONAL, DURATION),
    (31, 1016, HAS_PROPERTY, "1:RemainingTime", PROPERTY, OPTIONAL, DURATION),
    (32, 1016, HAS_PROPERTY, "1:MeasurementReason", PROPERTY, OPTIONAL, "ns=1;i=3009"),
    (33, 2004, HAS_PROPERTY, "1:UsedTools", PROPERTY, OPTIONAL, STRING),
)
TYPES = 'xmlns="http://opcfoundation.org/UA/2008/02/Types.xsd"'
GMS_VALUES = {
    # peculiarities of the published file: empty texts, an empty list, a structure that another node set defines
    17: f"<LocalizedText {TYPES}/>",
    24: f"<ListOfLocalizedText {TYPES}/>",
    22: f"<ExtensionObject {TYPES}><TypeId><Identifier>ns=2;i=5009</Identifier></TypeId><Body>"
    f'<ResultDataType xmlns="{RESULT}Types.xsd"><EncodingMask>0</EncodingMask><ResultMetaData>'
    "<EncodingMask>0</EncodingMask><ResultId/></ResultMetaData></ResultDataType></Body></ExtensionObject>",
}

WMTP_TYPES = (("UAObjectType", 1003, "WirelessMachineToolPeripheralType", OBJECT, ""),)
WMTP_DECLARATIONS = (
    (1, 1003, HAS_COMPONENT, "1:DeviceInformation", FOLDER, MANDATORY, ""),
    (2, 1, HAS_ADD_IN, "3:Identification", "ns=2;i=1005", OPTIONAL, ""),
    (3, 1003, HAS_COMPONENT, "1:Measurements", FOLDER, MANDATORY, ""),
    (4, 1003, HAS_COMPONENT, "2:MachineryBuildingBlocks", FOLDER, MANDATORY, ""),
)


def written_gms(path: Path, **changes: str) -> Path:
    """Write the node set of OPC 40210; see `_document` for the changes."""
    required = {MACHINE_TOOL: "1.01.1", RESULT: "1.00.0", DI: "1.04.0", MACHINERY: "1.02.0"}
    uris = (GMS, RESULT, MACHINE_TOOL, DI, MACHINERY)
    nodes = _nodes(GMS_TYPES, GMS_DECLARATIONS, GMS_VALUES)
    path.write_text(_document(uris, required, nodes, **changes), encoding="utf-8")
    return path


def written_wmtp(path: Path) -> Path:
    """Write the node set of OPC 40505."""
    nodes = _nodes(WMTP_TYPES, WMTP_DECLARATIONS, {})
    path.write_text(_document((WMTP, MACHINERY, DI), {MACHINERY: "1.03.0"}, nodes), encoding="utf-8")
    return path


def _document(uris, required, nodes, *, uri="", also_required="", old="") -> str:
    """Text of a node set. `uri` replaces its namespace, `also_required` is a further namespace on which it builds, and
    `old` the version that it wants of all of them."""
    models = [(one, old or version) for one, version in required.items()] + [(also_required, "")] * bool(also_required)
    bases = "".join(f'<RequiredModel ModelUri="{one}" Version="{version}"/>' for one, version in models)
    return (
        '<UANodeSet xmlns="http://opcfoundation.org/UA/2011/03/UANodeSet.xsd"><NamespaceUris>'
        + "".join(f"<Uri>{one}</Uri>" for one in uris)
        + f'</NamespaceUris><Models><Model ModelUri="{uri or uris[0]}" Version="1.0.0">{bases}</Model></Models>'
        + "<Aliases>"
        + "".join(f'<Alias Alias="{name}">{node}</Alias>' for name, node in ALIASES.items())
        + "</Aliases>"
        + "".join(nodes)
        + "</UANodeSet>"
    )


def _nodes(types, declarations, values):
    for tag, number, name, above, data_type in types:
        yield _node(tag, number, f"1:{name}", data_type, [(HAS_SUBTYPE, above, False)], "")
    for number, above, reference, name, kind, rule, data_type in declarations:
        references = [
            ("HasTypeDefinition", kind, True),
            ("HasModellingRule", rule, True),
            (reference, f"ns=1;i={above}", False),
        ]
        tag = "UAVariable" if data_type else "UAObject"
        yield _node(tag, number, name, data_type, references, values.get(number, ""))


def _node(tag, number, name, data_type, references, value) -> str:
    kind = f' DataType="{data_type}"' if data_type else ""
    lines = "".join(
        f'<Reference ReferenceType="{one}"{"" if forward else chr(32) + "IsForward=" + quoteattr("false")}>{other}'
        "</Reference>"
        for one, other, forward in references
    )
    content = f"<Value>{value}</Value>" if value else ""
    return (
        f'<{tag} NodeId="ns=1;i={number}" BrowseName="{name}"{kind}>'
        f"<DisplayName>{name.rpartition(':')[2]}</DisplayName><References>{lines}</References>{content}</{tag}>"
    )
