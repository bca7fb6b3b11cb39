"""Calibration of a simulated machine that is started as a process of its own, compared with the true errors that the
simulator knows."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import click

from agent.cli.printing import columns_table, results_console
from agent.cli.run_commands.cross_check import attempt
from agent.cli.run_commands.local_run import calibrate_here, conclude
from agent.cli.run_commands.run_summary import show_summary
from agent.cli.run_commands.sequential_options import ALL_POSITIONS, SequentialOptions
from agent.cli.run_commands.simulator_process import ANY_SOCKETCAND, SimulatorProcess
from agent.figures.heading import subject
from agent.files import translated
from agent.model_files import load_machine
from agent.planning.stations import load_artefacts
from agent.runs.session import RunResult
from agent.settings.load import naming
from agent.settings.schema import Settings
from drivers.errors import ConfigurationError, LinkError
from twin.formats.toml_reading import validate_document

SIMULATED_DRIVE = {
    "encoder_counts_per_revolution": 131072,
    "gear_motor_revolutions": 100,
    "speed_deg_per_s": 20.0,
    "acceleration_deg_per_s2": 40.0,
}
"""Driver options of each drive of a simulated mount."""
LIMITS_OF_DRIVE = {
    "azimuth": {"lower_deg": -180.0, "upper_deg": 180.0},
    "elevation": {"lower_deg": -90.0, "upper_deg": 90.0},
}
MODBUS, GRBL = "modbus-cnc", "serial-cnc"
LINKS = {MODBUS: "modbus", GRBL: "serial"}
"""Name of the link in the report of the simulator by the driver that uses it."""
ADDRESSES = ("host", "port", "serial")
"""Options of these drivers that say where the controller is."""
DECLARED = "declared_temperatures_c"
"""Option of GRBL with the temperatures that a person read, because it has no thermometer."""
WITHOUT_TABLES = (
    "GRBL stores no table, so the machine itself is unchanged: `volcal gcode correct` corrects part programs. The "
    "held-out positions show the effect of the table."
)


@dataclass(frozen=True)
class Truth:
    """True volumetric errors of a simulated machine, and the number of its collisions, as reported by the simulator.

    `before_um` and `after_um` are the true volumetric errors before and after the calibration, in µm. The best-fitting
    rigid motion of the workspace has been removed from them. `after_um` and `collisions` are None if the simulator
    could no longer be reached after the calibration. `after_um` is also None if the controller stores no tables.
    """

    before_um: float
    after_um: float | None
    collisions: int | None


@dataclass(frozen=True)
class Demonstrated:
    """Names of the demonstrated machine and its artefact. `case` is the name of the shipped case; it is None if a
    settings file of its own describes the machine.
    """

    case: str | None
    machine: str
    artefact: str

    @classmethod
    def of(cls, settings: Settings, case: str | None) -> Self:
        """Read the names of machine and artefact from the files that the settings name."""
        machine = load_machine(settings.machine)
        artefact = load_artefacts(settings.artefact, settings.stations).all
        return cls(case, machine.name, artefact.name)

    @property
    def text(self) -> str:
        shipped = "" if self.case is None else f"shipped case {self.case}: "
        return f"{shipped}{subject(self.machine, self.artefact)}"


def calibrate_simulated(
    settings: Settings,
    config: Path,
    scenario: Path,
    out: Path,
    *,
    case: str | None = None,
    can: str = ANY_SOCKETCAND,
    modbus_rtu: str | None = None,
    end: SequentialOptions = ALL_POSITIONS,
    cross_check: bool = False,
    as_json: bool,
) -> None:
    """Start the machine of a scenario as a process of its own, calibrate it with `settings` over its links, and print
    the result and the truth.

    `config` is the file of the settings, `case` the name of the shipped case to which it belongs, and `out` the state
    directory of the run. `end` says whether the positions are chosen one after the other. With `cross_check`, virtual
    instruments then measure the figures of acceptance tests that the estimate predicts. The result is printed even if
    this fails. Raises SystemExit afterwards if it failed, if the new table is not active, or if prediction and
    instruments contradict each other.
    """
    demonstrated = Demonstrated.of(settings, case)
    bus = None if settings.stations.placed_by_hand else can
    grbl = _machine_driver(settings) == GRBL
    log = out / "simulator.log"
    with SimulatorProcess(scenario, can=bus, log=log, modbus_rtu=modbus_rtu, grbl=grbl) as simulator:
        before = _aligned_um(simulator.ask("truth"), "active")
        connected = connect(settings, simulator.ready, out, simulator.ask("status")["temperatures_c"])
        click.echo(f"{demonstrated.text}\n{_introduction(simulator.ready)}", err=True)
        with naming(config):
            ended = calibrate_here(connected, config.resolve().parent, end)
        truth = _truth_after(simulator, before, in_controller=not grbl)
        checked = attempt(ended.outcome, connected, simulator, in_controller=not grbl) if cross_check else None
    if as_json:
        document = {**vars(demonstrated), **_document(ended, truth)}
        if checked is not None:
            document |= checked.as_json()
        click.echo(json.dumps(document, allow_nan=False))
    else:
        click.echo(demonstrated.text)
        _show(ended, truth)
        if grbl:
            click.echo(WITHOUT_TABLES)
        if checked is not None:
            checked.show()
    conclude(ended)
    if checked is not None:
        checked.conclude()


def connect(
    settings: Settings, ready: dict[str, Any], out: Path, temperatures_c: Mapping[str, float] | None = None
) -> Settings:
    """Return a copy of `settings` that refers to the running simulator and uses `out` as state directory, in which the
    run stores its journal and results. If the settings are those of a real machine, the simulated devices replace all
    of its devices; a machine with GRBL is reached over a serial line, any other over Modbus.

    `ready` is the report by which the simulator announces that it is ready. The report contains the addresses of the
    simulated devices and of the simulator's clock. `temperatures_c` are the temperatures of the simulated machine; they
    replace those that a person declared for the real one.
    """
    document = settings.model_dump(mode="json")
    if settings.clock.kind != "lockstep":
        document |= _simulated_devices(settings, ready, out, temperatures_c or {})
    devices = document["devices"]
    roles = document["roles"]
    for device in devices.values():
        if device["driver"] in LINKS:
            kept = {name: value for name, value in device["options"].items() if name not in ADDRESSES}
            device["options"] = kept | ready[LINKS[device["driver"]]]
    for mount in _mounts_in(roles["mount"]):
        devices[mount]["options"] |= ready["can"]
    devices[roles["operator"]]["options"] |= ready["control"]
    document["clock"] = {"kind": "lockstep", **ready["time"]}
    document["state_directory"] = str(out.resolve())
    with translated(ConfigurationError):
        return validate_document(document, "settings of the demonstration", Settings)


def _machine_driver(settings: Settings) -> str:
    """Return the name of the driver of the controller, "" if the settings have no such device."""
    device = settings.devices.get(settings.roles.machine)
    return "" if device is None else device.driver


def _mounts_in(role: str | dict[int, str] | None) -> list[str]:
    """Return the names of the mounts in the setting `roles.mount`."""
    if role is None:
        return []
    return [role] if isinstance(role, str) else list(role.values())


def _simulated_devices(
    settings: Settings, ready: dict[str, Any], out: Path, temperatures_c: Mapping[str, float]
) -> dict[str, Any]:
    """Return the sections `devices` and `roles` of a machine whose devices are those of the simulator. Like the real
    machine, it has one mount, one at each station, or none."""
    grbl = _machine_driver(settings) == GRBL
    several = isinstance(settings.roles.mount, dict)
    mounts = {f"mount-{number}": nodes for number, nodes in ready["can_mounts"].items()}
    devices: dict[str, Any] = {
        "cnc": _simulated_grbl(settings, out, temperatures_c) if grbl else {"driver": MODBUS, "options": {}},
        "operator": {"driver": "simulated-operator", "options": {}},
    }
    for name, nodes in mounts.items():
        axes = {axis: {"node_id": node, **SIMULATED_DRIVE, **LIMITS_OF_DRIVE[axis]} for axis, node in nodes.items()}
        devices[name] = {"driver": "canopen-mount", "options": {"sdo_timeout_s": 1.0, **axes}}
    roles: dict[str, Any] = dict.fromkeys(("machine", "probe", "store", "thermometer"), "cnc")
    roles["operator"] = "operator"
    if grbl and settings.roles.thermometer != settings.roles.machine:
        devices["thermometer"] = {"driver": MODBUS, "options": {}}
        roles["thermometer"] = "thermometer"
    if not settings.stations.placed_by_hand:
        roles["mount"] = {number: f"mount-{number}" for number in ready["can_mounts"]} if several else "mount-1"
    return {"devices": devices, "roles": roles}


def _simulated_grbl(settings: Settings, out: Path, temperatures_c: Mapping[str, float]) -> dict[str, Any]:
    """Return the section of a simulated controller with GRBL. It has the options of the real one, but its banks are in
    `out`: a simulated run must not change the tables of the real machine."""
    options = settings.model_dump(mode="json")["devices"][settings.roles.machine]["options"]
    declared = {name: temperatures_c.get(name, value) for name, value in options.get(DECLARED, {}).items()}
    banks = {**options.get("banks", {}), "directory": str(out.resolve() / "banks")}
    return {"driver": GRBL, "options": {**options, DECLARED: declared, "banks": banks}}


def _truth_after(simulator: SimulatorProcess, before_um: float, *, in_controller: bool) -> Truth:
    """Return the truth after a run. The error after it is known only if the table is `in_controller`."""
    try:
        after = _aligned_um(simulator.ask("truth"), "active") if in_controller else None
        return Truth(before_um, after, int(simulator.ask("collisions")["count"]))
    except LinkError:
        return Truth(before_um, None, None)


def _aligned_um(truth: dict[str, Any], which: str) -> float:
    return float(truth[which]["aligned_um"])


def _introduction(ready: dict[str, Any]) -> str:
    modbus, can, grbl = ready["modbus"], ready["can"], ready["serial"]
    rtu = modbus.get("serial")
    if grbl:
        link = f"GRBL on {grbl['port']}, {grbl['baud']} baud"
    elif rtu:
        link = f"Modbus RTU {rtu['port']} {rtu['baud']} baud"
    else:
        link = f"Modbus TCP {modbus['host']}:{modbus['port']}"
    bus = "no mount" if can is None else f"CAN {can['interface']} {can['channel']}{_address(can['options'])}"
    return f"simulated machine in a process of its own: {link}, {bus}"


def _address(options: dict[str, Any]) -> str:
    """Return the place of a CAN bus that is reached over TCP, as a text that follows its name."""
    return f" at {options['host']}:{options['port']}" if {"host", "port"} <= set(options) else ""


def _document(ended: RunResult, truth: Truth) -> dict[str, object]:
    return {
        **ended.outcome.as_json(),
        "true_ve_before_um": truth.before_um,
        "true_ve_after_um": truth.after_um,
        "collisions": truth.collisions,
        "figures": _figures(ended, truth),
    }


def _figures(ended: RunResult, truth: Truth) -> list[dict[str, object]]:
    """Return the stated figures whose true values the simulator knows, each with its truth and its 95 % limits.

    The error after compensation is compared only if the new table passed its proof and is active.
    """
    outcome = ended.outcome
    if outcome.estimation is None:
        return []
    proved = outcome.proof is not None and outcome.proof.accepted
    volumetric = outcome.estimation.volumetric
    figures = (
        ("ve_before", truth.before_um, volumetric.before_aligned),
        ("vce_after", truth.after_um if proved else None, volumetric.after_aligned),
    )
    return [
        {
            "figure": name,
            "true_um": true_um,
            "stated_um": stated.value_um,
            "limits_um": list(stated.limits_um),
            "inside": stated.limits_um[0] <= true_um <= stated.limits_um[1],
        }
        for name, true_um, stated in figures
        if true_um is not None and stated.limits_um is not None
    ]


def _show(ended: RunResult, truth: Truth) -> None:
    table = columns_table(("", "before", "after"), title="true volumetric error (rigidly aligned), from the simulator")
    after = "?" if truth.after_um is None else f"{truth.after_um:.2f} µm"
    table.add_row("VE", f"{truth.before_um:.2f} µm", after)
    table.add_row("collisions", "", "?" if truth.collisions is None else str(truth.collisions))
    results_console().print(table)
    show_summary(ended.outcome)
