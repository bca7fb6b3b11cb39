"""The machine under ``Objects/Machines`` as data: an instance of MachineToolType (OPC 40501-1) with the parts of OPC
40001 that this program has values for. docs/reference/opc-ua.md shows the same tables.

A path is the identifier of a node in the own namespace, without the leading ``Machine.``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from importlib.metadata import version
from typing import Final

from agent.execution.states import RunState
from agent.results.run_verdict import Look
from agent.service.control import Status
from agent.service.opcua.companion_types import (
    BASE_OBJECT,
    DEVICES,
    FOLDER,
    ITEM_STATE,
    MACHINE_TOOL,
    MACHINERY,
    MESSAGES,
    OPERATION_MODE,
    PROGRAM_STATE,
    RESULT,
    RESULT_MANAGEMENT,
    RESULT_VARIABLE,
    SOFTWARE,
    CompanionType,
)
from agent.service.opcua.last_calibration import CalibrationResult, JournalResults
from agent.service.opcua.model import NAMESPACE, PROGRAM_STATES
from agent.settings.opcua import IdentificationPlate, OpcUaSettings

MACHINE: Final = "Machine"
S = RunState
MachineValue = str | float | int | datetime | tuple[str, ...]


@dataclass(frozen=True)
class Facts:
    """All that was read: the status of the service, the settings, and what the journal says."""

    status: Status
    settings: OpcUaSettings
    results: JournalResults

    @property
    def result(self) -> CalibrationResult | None:
        return self.results.last

    @property
    def plate(self) -> IdentificationPlate:
        return self.settings.identification


@dataclass(frozen=True)
class OptionalPart:
    """Object or variable that the types leave optional. `namespace` is that of its browse name. `reference` is the type
    of the reference with which the specification attaches it, if it is not HasComponent."""

    path: str
    namespace: str
    type: CompanionType
    reference: str = ""


def _never(_: Facts) -> bool:
    return False


def no_run(facts: Facts) -> bool:
    return facts.status.run_id is None


def no_result(facts: Facts) -> bool:
    return facts.result is None


@dataclass(frozen=True)
class MachineVariable:
    """Variable of the machine. `of` returns its value, or None if there is none; the variable then has the status
    BadWaitingForInitialData if `awaited` is True, otherwise BadNoData. `form` is a type of OPC UA, followed by [] if
    the value is an array; a NodeId is given as the path of the node.

    `namespace` is that of the browse name if the variable is not mandatory in its type, and `is_property` is then True
    if the type has it as a property. `enumeration` is the number of its data type in this namespace.
    """

    path: str
    form: str
    meaning: str
    of: Callable[[Facts], MachineValue | None]
    awaited: Callable[[Facts], bool] = _never
    namespace: str = ""
    in_micrometres: bool = False
    enumeration: int | None = None
    is_property: bool = False


@dataclass(frozen=True)
class StateMachine:
    """State machine whose states are those of `type`. `of` returns the name of the state, or None. `numbered` is True
    if its type also has the number of the current state."""

    path: str
    type: CompanionType
    meaning: str
    of: Callable[[Facts], str | None]
    awaited: Callable[[Facts], bool] = _never
    numbered: bool = False


AT_WORK: Final = {
    S.PREFLIGHT: "NotExecuting",
    S.HELD: "NotExecuting",
    S.WRITTEN: "NotExecuting",
    S.RESUMING: "Executing",
    S.MEASURING: "Executing",
    S.IDENTIFYING: "Executing",
    S.STAGING: "Executing",
    S.ACTIVATING: "Executing",
    S.VERIFYING: "Executing",
    S.RESTORING: "Executing",
    S.ABORTING: "Executing",
}
"""State of the machine (OPC 40001-1, 12.2) during a run. Between runs this program does not know what the machine
does."""

_EVALUATION: Final = {Look.GOOD: 1, Look.BAD: 2, Look.REFUSED: 2}
_UNDECIDABLE: Final = 3
"""ResultEvaluationEnum (OPC 40001-101): 1 OK, 2 NotOK, 3 NotDecidable."""

_BLOCKS: Final = "MachineryBuildingBlocks"
_SOFTWARE: Final = "Identification.SoftwareIdentification"
RESULTS: Final = f"{_BLOCKS}.ResultManagement"
LAST: Final = f"{RESULTS}.Results.LastCalibration"
READY_EVENT: Final = "CalibrationReadyEventType"
LAST_META: Final = f"{LAST}.ResultMetaData"
CALIBRATION: Final = "Monitoring.Calibration"
ALERTS: Final = "Notification.Messages"

PARTS: Final = (
    OptionalPart(_SOFTWARE, MACHINE_TOOL, BASE_OBJECT),
    OptionalPart(f"{_SOFTWARE}.volcal", NAMESPACE, SOFTWARE),
    OptionalPart(_BLOCKS, MACHINERY, FOLDER),
    OptionalPart(f"{_BLOCKS}.MachineryItemState", MACHINERY, ITEM_STATE, reference="HasAddIn"),
    OptionalPart(f"{_BLOCKS}.MachineryOperationMode", MACHINERY, OPERATION_MODE, reference="HasAddIn"),
    OptionalPart(f"{_BLOCKS}.ResultManagement", RESULT, RESULT_MANAGEMENT, reference="HasAddIn"),
    OptionalPart(f"{_BLOCKS}.ResultManagement.Results", RESULT, FOLDER),
    OptionalPart(LAST, NAMESPACE, RESULT_VARIABLE),
    OptionalPart(ALERTS, MACHINE_TOOL, MESSAGES),
)

SHARED_PARTS: Final = (
    (_BLOCKS, "Identification"),
    ("Monitoring.MachineTool", f"{_BLOCKS}.MachineryItemState"),
    ("Monitoring.MachineTool", f"{_BLOCKS}.MachineryOperationMode"),
)
"""Parts that have a second place, attached with HasAddIn: the place and the part."""

SHARED_VARIABLES: Final = (
    "Monitoring/PackMLState",
    "Monitoring/RunState",
    "Monitoring/Doing",
    "Monitoring/ActiveBank",
    "Monitoring/BankWaiting",
    "Monitoring/UnprovedTable",
    "Production/Job/Kind",
    "Production/Job/Started",
    "Production/Job/Progress",
    "Production/Job/RemainingTime",
    "Production/Job/Balls",
    "Production/Job/Touches",
)
"""Variables of the object `Volcal` that are also components of the monitored element `Calibration`."""


def program_state(facts: Facts) -> str | None:
    """Return the state of the last run since the start of the service, as a state of a production program."""
    return None if facts.status.run_id is None else PROGRAM_STATES[facts.status.state]


def _result(of: Callable[[CalibrationResult], MachineValue | None]) -> Callable[[Facts], MachineValue | None]:
    return lambda facts: None if facts.result is None else of(facts.result)


MACHINE_VARIABLES: Final = (
    MachineVariable(
        "Identification.Manufacturer", "LocalizedText", "`opcua.identification.manufacturer`",
        lambda f: f.plate.manufacturer,
    ),
    MachineVariable(
        "Identification.SerialNumber", "String", "`opcua.identification.serial_number`",
        lambda f: f.plate.serial_number,
    ),
    MachineVariable(
        "Identification.ProductInstanceUri", "String", "`opcua.identification.product_instance_uri`",
        lambda f: f.plate.product_instance_uri,
    ),
    MachineVariable(
        "Identification.Model", "LocalizedText", "`opcua.identification.model`",
        lambda f: f.plate.model, namespace=DEVICES, is_property=True,
    ),
    MachineVariable(
        "Identification.Location", "String", "`opcua.identification.location`",
        lambda f: f.plate.location, namespace=MACHINERY, is_property=True,
    ),
    MachineVariable(
        "Identification.YearOfConstruction", "UInt16", "`opcua.identification.year_of_construction`",
        lambda f: f.plate.year_of_construction, namespace=MACHINERY, is_property=True,
    ),
    MachineVariable(
        "Identification.ComponentName", "LocalizedText", "name of the machine file",
        lambda f: f.status.machine, namespace=DEVICES, is_property=True,
    ),
    MachineVariable(f"{_SOFTWARE}.volcal.Identifier", "String", "volcal", lambda _: "volcal"),
    MachineVariable(
        f"{_SOFTWARE}.volcal.SoftwareRevision", "String", "version of volcal", lambda _: version("volcal")
    ),
    MachineVariable(
        "Monitoring.MachineTool.OperationMode", "Int32", "no value: volcal does not read the mode of the controller",
        lambda _: None,
    ),
    MachineVariable(f"{CALIBRATION}.Name", "String", "Calibration", lambda _: "Calibration"),
    MachineVariable(
        "Production.ActiveProgram.Name", "String", "position set of the run",
        lambda f: f.status.position_set, no_run,
    ),
    MachineVariable("Production.ActiveProgram.NumberInList", "UInt16", "0: there is one program", lambda _: 0),
    MachineVariable(
        "Production.ActiveProgram.JobIdentifier", "String", "identity of the run",
        lambda f: f.status.run_id, no_run, MACHINE_TOOL,
    ),
    MachineVariable(
        f"{LAST_META}.ResultId", "String", "identity of the run", _result(lambda r: r.run_id), no_result
    ),
    MachineVariable(
        f"{LAST_META}.JobId", "String", "identity of the run", _result(lambda r: r.run_id), no_result, RESULT
    ),
    MachineVariable(
        f"{LAST_META}.CreationTime", "DateTime", "end of the run", _result(lambda r: r.ended), no_result, RESULT
    ),
    MachineVariable(
        f"{LAST_META}.ResultEvaluation", "Int32", "verdict: 1 OK, 2 NotOK, 3 NotDecidable",
        _result(lambda r: _EVALUATION.get(r.verdict.look, _UNDECIDABLE)), no_result, RESULT, enumeration=3002,
    ),
    MachineVariable(
        f"{LAST_META}.ResultEvaluationDetails", "LocalizedText", "verdict as a sentence",
        _result(lambda r: r.verdict.sentence["en"]), no_result, RESULT,
    ),
    MachineVariable(
        f"{LAST}.Verdict", "String", "verdict as a stable word, such as accepted",
        _result(lambda r: r.verdict.name), no_result, NAMESPACE,
    ),
    MachineVariable(
        f"{LAST}.VE", "Double", "µm, volumetric error without a table, aligned",
        _result(lambda r: r.ve_um), no_result, NAMESPACE, in_micrometres=True,
    ),
    MachineVariable(
        f"{LAST}.VCE", "Double", "µm, volumetric error with the table active at the end of the run, aligned",
        _result(lambda r: r.vce_um), no_result, NAMESPACE, in_micrometres=True,
    ),
)  # fmt: skip

STATE_MACHINES: Final = (
    StateMachine(
        "Production.ActiveProgram.State",
        PROGRAM_STATE,
        "Initializing, Running, Interrupted, Ended or Aborted: the last run since the start of the service",
        program_state,
        no_run,
        numbered=True,
    ),
    StateMachine(
        f"{_BLOCKS}.MachineryItemState",
        ITEM_STATE,
        "during a run Executing or, in the preflight and while it is held, NotExecuting; otherwise no value",
        lambda f: AT_WORK.get(f.status.state),
    ),
    StateMachine(
        f"{_BLOCKS}.MachineryOperationMode",
        OPERATION_MODE,
        "Maintenance during a run; otherwise no value",
        lambda f: "Maintenance" if f.status.state in AT_WORK else None,
    ),
)
