"""Namespaces and types of the companion specifications that the address space uses, with their identifiers in the
published node sets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

UA: Final = "http://opcfoundation.org/UA/"
DEVICES: Final = "http://opcfoundation.org/UA/DI/"
INDUSTRIAL_AUTOMATION: Final = "http://opcfoundation.org/UA/IA/"
MACHINERY: Final = "http://opcfoundation.org/UA/Machinery/"
JOB_CONTROL: Final = "http://opcfoundation.org/UA/ISA95-JOBCONTROL_V2/"
JOBS: Final = "http://opcfoundation.org/UA/Machinery/Jobs/"
MACHINE_TOOL: Final = "http://opcfoundation.org/UA/MachineTool/"
RESULT: Final = "http://opcfoundation.org/UA/Machinery/Result/"
MEASURING: Final = "http://opcfoundation.org/UA/GMS/"
PERIPHERALS: Final = "http://opcfoundation.org/UA/WMTP/"


@dataclass(frozen=True)
class CompanionType:
    """Node of a published node set: a type, or the folder of the machines."""

    namespace: str
    number: int
    name: str


MACHINES: Final = CompanionType(MACHINERY, 1001, "Machines")
MACHINE_TOOL_TYPE: Final = CompanionType(MACHINE_TOOL, 13, "MachineToolType")
ITEM_STATE: Final = CompanionType(MACHINERY, 1002, "MachineryItemState_StateMachineType")
OPERATION_MODE: Final = CompanionType(MACHINE_TOOL, 1003, "MachineOperationModeStateMachineType")
PROGRAM_STATE: Final = CompanionType(MACHINE_TOOL, 15, "ProductionProgramStateMachineType")
SOFTWARE: Final = CompanionType(MACHINE_TOOL, 43, "SoftwareIdentificationType")
MONITORED_ELEMENT: Final = CompanionType(MACHINE_TOOL, 23, "ElementMonitoringType")
MESSAGES: Final = CompanionType(MACHINE_TOOL, 38, "MessagesType")
NOTIFICATION_EVENT: Final = CompanionType(MACHINE_TOOL, 35, "NotificationEventType")
ALERT: Final = CompanionType(MACHINE_TOOL, 39, "AlertType")
RESULT_MANAGEMENT: Final = CompanionType(RESULT, 1004, "ResultManagementType")
RESULT_READY: Final = CompanionType(RESULT, 1002, "ResultReadyEventType")
RESULT_VARIABLE: Final = CompanionType(RESULT, 2001, "ResultType")
FOLDER: Final = CompanionType(UA, 61, "FolderType")
BASE_OBJECT: Final = CompanionType(UA, 58, "BaseObjectType")
TOOL_LIST: Final = CompanionType(MACHINE_TOOL, 44, "ToolListType")
PROGNOSES: Final = CompanionType(MACHINE_TOOL, 2, "PrognosisListType")
PRODUCTION_PLAN: Final = CompanionType(MACHINE_TOOL, 30, "ProductionJobListType")
JOB_STATE: Final = CompanionType(MACHINE_TOOL, 28, "ProductionJobStateMachineType")
COMPONENT_IDENTIFICATION: Final = CompanionType(MACHINERY, 1005, "MachineryComponentIdentificationType")

MEASURING_SYSTEM: Final = CompanionType(MEASURING, 1002, "GMSType")
SENSOR: Final = CompanionType(MEASURING, 1007, "SensorType")
TOOL_MONITORING: Final = CompanionType(MEASURING, 1006, "ToolMonitoringType")
CALIBRATION_PROGNOSIS: Final = CompanionType(MEASURING, 1019, "CalibrationPrognosisType")
MEASURING_JOB: Final = CompanionType(MEASURING, 1016, "GMSJobType")
MEASURING_RESULT: Final = CompanionType(MEASURING, 2004, "GMSResultType")
PERIPHERAL: Final = CompanionType(PERIPHERALS, 1003, "WirelessMachineToolPeripheralType")

USED_TYPES: Final = (
    MACHINES, MACHINE_TOOL_TYPE, ITEM_STATE, OPERATION_MODE, PROGRAM_STATE, SOFTWARE, MONITORED_ELEMENT, MESSAGES,
    NOTIFICATION_EVENT, ALERT, RESULT_MANAGEMENT, RESULT_READY, RESULT_VARIABLE,
    TOOL_LIST, PROGNOSES, PRODUCTION_PLAN, JOB_STATE, COMPONENT_IDENTIFICATION,
    MEASURING_SYSTEM, SENSOR, TOOL_MONITORING, CALIBRATION_PROGNOSIS, MEASURING_JOB, MEASURING_RESULT, PERIPHERAL,
)  # fmt: skip
"""Types whose presence is checked; those of a namespace that is not loaded are not used."""
