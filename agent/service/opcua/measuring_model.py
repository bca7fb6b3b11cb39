"""Nodes that further node sets add to the machine, as data: with that of OPC 40210 it is a measuring system, and with
that of OPC 40505 its touch probe is a peripheral. docs/reference/opc-ua.md shows the same tables.

Of these specifications only that is here for which this program has a value, and what is mandatory beside it.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from datetime import timedelta
from typing import Final

from agent.execution.states import RunState
from agent.results.run_verdict import FULL_NEEDED, OUT, PROOF_FAILED, Look
from agent.service.opcua.companion_types import (
    CALIBRATION_PROGNOSIS,
    COMPONENT_IDENTIFICATION,
    DEVICES,
    JOB_STATE,
    MACHINE_TOOL,
    MEASURING,
    MEASURING_JOB,
    PERIPHERALS,
    PRODUCTION_PLAN,
    PROGNOSES,
    SENSOR,
    TOOL_LIST,
    TOOL_MONITORING,
)
from agent.service.opcua.machine_model import (
    AT_WORK,
    LAST,
    RESULTS,
    Facts,
    MachineValue,
    MachineVariable,
    OptionalPart,
    StateMachine,
    no_result,
    no_run,
    program_state,
)
from agent.service.opcua.model import NAMESPACE

MS_PER_DAY: Final = 86_400_000.0
MS_PER_MINUTE: Final = 60_000.0

PROBE: Final = "Equipment.Tools.Probe"
RESULTS_FOLDER: Final = f"{RESULTS}.Results"
PERIPHERAL_ROOT: Final = "TouchProbe"
_WATCH: Final = "Monitoring.ToolMonitoring"
_PROGNOSIS: Final = "Notification.Prognoses.Calibration"
_JOB: Final = "Production.ProductionPlan.Run"
_DEVICE: Final = f"{PERIPHERAL_ROOT}.DeviceInformation.Identification"
_BLOCK: Final = f"{PERIPHERAL_ROOT}.MachineryBuildingBlocks.Identification"

_TOUCH_TRIGGER: Final = 3
"""Class of a SensorType: TactileTouchTrigger."""
_QUALIFIED: Final = 0
"""ToolIsQualifiedStatus: 0 Qualified, 1 Imprecise, 2 NotQualified."""
_REASONS: Final = {"nightly": 0, "verify": 2, "calibrate": 1}
"""MeasurementReasonEnum: 0 ContinuousMeasurements, 1 SpecialMeasurement, 2 AuditMeasurement."""
_NOT_CALIBRATED: Final = frozenset({OUT.name, FULL_NEEDED.name, PROOF_FAILED.name})
_COMPLETED: Final = frozenset({RunState.COMPLETE, RunState.REFUSED})


@dataclass(frozen=True)
class Addition:
    """Nodes that exist if the node set with the URI `namespace` is loaded. `shared_parts` have a second place: the
    place, the type of the reference and the part."""

    namespace: str
    specification: str
    parts: tuple[OptionalPart, ...]
    variables: tuple[MachineVariable, ...]
    state_machines: tuple[StateMachine, ...] = ()
    shared_parts: tuple[tuple[str, str, str], ...] = ()


def _at_work(facts: Facts) -> bool:
    return facts.status.state in AT_WORK


def _calibrated(facts: Facts) -> MachineValue | None:
    if facts.result is None:
        return None
    verdict = facts.result.verdict
    return True if verdict.look is Look.GOOD else False if verdict.name in _NOT_CALIBRATED else None


def _interval_ms(facts: Facts) -> MachineValue | None:
    days = facts.settings.calibration_interval_days
    return None if days is None else days * MS_PER_DAY


def _next_calibration(facts: Facts) -> MachineValue | None:
    days = facts.settings.calibration_interval_days
    if days is None or facts.results.last_good is None:
        return None
    return facts.results.last_good.ended + timedelta(days=days)


def _next_awaited(facts: Facts) -> bool:
    return facts.settings.calibration_interval_days is not None and _no_good_result(facts)


def _no_good_result(facts: Facts) -> bool:
    return facts.results.last_good is None


def _remaining_ms(facts: Facts) -> MachineValue | None:
    minutes = facts.status.minutes_left
    return None if minutes is None or not _at_work(facts) else minutes * MS_PER_MINUTE


def _runs_completed(facts: Facts) -> MachineValue | None:
    return None if facts.status.run_id is None else int(facts.status.state in _COMPLETED)


def _used_tools(facts: Facts) -> MachineValue | None:
    serial_number = None if facts.result is None else facts.result.probe_serial_number
    return None if serial_number is None else (serial_number,)


def _plate(path: str) -> tuple[MachineVariable, ...]:
    return (
        MachineVariable(
            f"{path}.Manufacturer", "LocalizedText", "`opcua.probe.manufacturer`",
            lambda f: f.settings.probe.manufacturer,
        ),
        MachineVariable(
            f"{path}.SerialNumber", "String", "`opcua.probe.serial_number`", lambda f: f.settings.probe.serial_number
        ),
        MachineVariable(
            f"{path}.Model", "LocalizedText", "`opcua.probe.model`", lambda f: f.settings.probe.model,
            namespace=DEVICES, is_property=True,
        ),
    )  # fmt: skip


MEASURING_ADDITION: Final = Addition(
    MEASURING,
    "OPC 40210 Geometric Measuring Systems",
    (
        OptionalPart("Equipment.Tools", MACHINE_TOOL, TOOL_LIST),
        OptionalPart(PROBE, NAMESPACE, SENSOR),
        OptionalPart(_WATCH, MEASURING, TOOL_MONITORING),
        OptionalPart("Notification.Prognoses", MACHINE_TOOL, PROGNOSES),
        OptionalPart(_PROGNOSIS, MEASURING, CALIBRATION_PROGNOSIS),
        OptionalPart("Production.ProductionPlan", MACHINE_TOOL, PRODUCTION_PLAN),
        OptionalPart(_JOB, NAMESPACE, MEASURING_JOB, reference="HasOrderedComponent"),
    ),
    (
        MachineVariable(f"{PROBE}.Class", "UInt32", "3: TactileTouchTrigger", lambda _: _TOUCH_TRIGGER),
        MachineVariable(
            f"{PROBE}.Alignment", "Int32", "no value: volcal does not read how the probe is held", lambda _: None,
            namespace=MEASURING, enumeration=3004, is_property=True,
        ),
        MachineVariable(
            f"{PROBE}.IsQualifiedStatus", "Int32",
            "0: Qualified if the latest run that has begun to check the probe has qualified the stylus; otherwise no "
            "value",
            lambda f: _QUALIFIED if f.results.stylus_qualified else None,
            namespace=MEASURING, enumeration=3002, is_property=True,
        ),
        MachineVariable(
            f"{PROBE}.Identifier", "String", "`opcua.probe.serial_number`",
            lambda f: f.settings.probe.serial_number, namespace=MACHINE_TOOL, is_property=True,
        ),
        MachineVariable(
            f"{PROBE}.Name", "String", "`opcua.probe.model`",
            lambda f: f.settings.probe.model, namespace=MACHINE_TOOL, is_property=True,
        ),
        MachineVariable(
            f"{PROBE}.ControlIdentifier1", "UInt32", "no value: volcal does not read the tool table", lambda _: None
        ),
        MachineVariable(f"{PROBE}.ControlIdentifierInterpretation", "Int32", "no value", lambda _: None),
        MachineVariable(f"{PROBE}.Locked", "Boolean", "no value", lambda _: None),
        MachineVariable(f"{PROBE}.Locked.ReasonForLocking", "Int32", "no value", lambda _: None),
        MachineVariable(f"{_WATCH}.Name", "String", "Probe", lambda _: "Probe"),
        MachineVariable(
            f"{_WATCH}.ActiveTool", "NodeId[]", "during a run the node of the probe; otherwise no value",
            lambda f: (PROBE,) if _at_work(f) else None, namespace=MEASURING, is_property=True,
        ),
        MachineVariable(
            f"{_PROGNOSIS}.Calibrated", "Boolean",
            "verdict on the last calibration: true if it is good; false if the machine was out of its limits, if it "
            "needs a full calibration or if the proof has failed; otherwise no value",
            _calibrated, no_result,
        ),
        MachineVariable(
            f"{_PROGNOSIS}.DateOfCalibration", "DateTime", "end of the last calibration whose verdict is good",
            lambda f: None if f.results.last_good is None else f.results.last_good.ended, _no_good_result,
        ),
        MachineVariable(
            f"{_PROGNOSIS}.PredictedTime", "DateTime",
            "next calibration: end of the last one whose verdict is good and `opcua.calibration_interval_days`",
            _next_calibration, _next_awaited,
        ),
        MachineVariable(
            f"{_PROGNOSIS}.CalibrationInterval", "Duration", "ms, `opcua.calibration_interval_days`",
            _interval_ms, namespace=MEASURING, is_property=True,
        ),
        MachineVariable(f"{_JOB}.Identifier", "String", "identity of the run", lambda f: f.status.run_id, no_run),
        MachineVariable(f"{_JOB}.NumberInList", "UInt16", "0: there is one job", lambda _: 0),
        MachineVariable(f"{_JOB}.RunsPlanned", "UInt32", "1", lambda f: None if no_run(f) else 1, no_run),
        MachineVariable(
            f"{_JOB}.RunsPlanned.IsValid", "Boolean", "true", lambda f: None if no_run(f) else True, no_run
        ),
        MachineVariable(
            f"{_JOB}.RunsCompleted", "UInt32", "1 once the run has ended with a result, until then 0",
            _runs_completed, no_run,
        ),
        MachineVariable(
            f"{_JOB}.RemainingTime", "Duration", "ms of machine time; no value between runs and before it is computed",
            _remaining_ms, namespace=MEASURING, is_property=True,
        ),
        MachineVariable(
            f"{_JOB}.MeasurementReason", "Int32",
            "0 ContinuousMeasurements: nightly run; 1 SpecialMeasurement: calibration; 2 AuditMeasurement: "
            "verification",
            lambda f: _REASONS.get(f.status.kind or ""), no_run,
            namespace=MEASURING, enumeration=3009, is_property=True,
        ),
        MachineVariable(
            f"{LAST}.UsedTools", "String[]",
            "`opcua.probe.serial_number` of the settings with which the run was started; no value if they do not name "
            "it",
            _used_tools, no_result, namespace=MEASURING, is_property=True,
        ),
    ),
    (
        StateMachine(
            f"{_JOB}.State", JOB_STATE,
            "Initializing, Running, Interrupted, Ended or Aborted: the last run since the start of the service",
            program_state, no_run, numbered=True,
        ),
    ),
    (("ResultManagement", "HasComponent", RESULTS_FOLDER),),
)  # fmt: skip

PERIPHERAL_ADDITION: Final = Addition(
    PERIPHERALS,
    "OPC 40505 Wireless Machine Tool Peripherals",
    (
        OptionalPart(_DEVICE, DEVICES, COMPONENT_IDENTIFICATION, reference="HasAddIn"),
        OptionalPart(_BLOCK, DEVICES, COMPONENT_IDENTIFICATION, reference="HasAddIn"),
    ),
    (*_plate(_DEVICE), *_plate(_BLOCK)),
)

ADDITIONS: Final = (MEASURING_ADDITION, PERIPHERAL_ADDITION)


def additions_of(loaded: Collection[str]) -> tuple[Addition, ...]:
    """Return the additions whose namespaces are among the `loaded` ones."""
    return tuple(one for one in ADDITIONS if one.namespace in loaded)
