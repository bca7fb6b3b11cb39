"""Rig of the preflight, the simulated execution of a plan. One simulated device has all roles."""

from __future__ import annotations

from agent.execution.device_assembly import mount_at_station, stations_of
from agent.execution.rig import Rig, in_role
from agent.execution.steps import Point
from agent.planning.job import Job
from drivers.clock import VirtualClock
from drivers.registry import DeviceContext, create_device
from drivers.roles import CompensationStore, Machine, Operator, Probe, Thermometer


def assemble_preflight_rig(job: Job, clock: VirtualClock, start_mm: Point | None) -> Rig:
    """Return a rig for the simulated execution of the plan of `job`. One simulated device has all roles: machine,
    probe, mount and so on.

    The setting `preflight.driver` names the driver of this device. The device simulates the machine described by the
    machine file, but without geometric errors, because a preflight checks only the procedure.
    """
    settings = job.settings
    options: dict[str, object] = {
        "machine": str(settings.machine),
        "artefact": str(settings.artefact),
        "tool": settings.tool,
        "mount": vars(settings.mount),
        "probe": vars(job.layout.probe),
        "stations_mm": [list(place) for place in settings.stations.places_mm],
        "standing_at": settings.stations.standing_at or 1,
        "mount_behaviour": settings.timing.model_dump(include={"speed_deg_per_s", "acceleration_deg_per_s2"}),
        "ideal": True,
        **_own_at_stations(job),
    }
    if start_mm is not None:
        options["start_mm"] = list(start_mm)
    context = DeviceContext("preflight", clock, settings.machine.parent)
    device = create_device(settings.preflight.driver, options, context)
    devices = {"preflight": device}
    return Rig(
        devices=devices,
        machine=in_role(devices, "preflight", Machine, "preflight.driver"),
        probe=in_role(devices, "preflight", Probe, "preflight.driver"),
        mounts={
            n: mount_at_station(devices, "preflight", n, "preflight.driver")
            for n in stations_of(settings.stations)
            if not settings.stations.placed_by_hand
        },
        store=in_role(devices, "preflight", CompensationStore, "preflight.driver"),
        thermometer=in_role(devices, "preflight", Thermometer, "preflight.driver"),
        operator=in_role(devices, "preflight", Operator, "preflight.driver"),
        clock=clock,
    )


def _own_at_stations(job: Job) -> dict[str, object]:
    """Return additional options of the simulated machine if the artefact is placed by hand or if each station has a
    mount of its own, else an empty dict."""
    change, settings = job.rules.change, job.settings
    if settings.stations.placed_by_hand:
        return {"placed_by_hand": {}}
    if not change.own_mounts:
        return {}
    return {
        "own_mounts": True,
        "artefacts": [str(path) for path in settings.stations.artefacts or ()],
        "mounts_deg": [list(change.parked_deg)] * len(change.own_mounts),
    }
