"""The simulated world: one machine, one mount with its artefact, one clock that others drive."""

from __future__ import annotations

from dataclasses import dataclass

from simulators.scenario import Scenario
from simulators.world.ageing import aged
from simulators.world.controller import Controller
from simulators.world.mount import MountPhysics
from simulators.world.noise import generator
from simulators.world.thermal import Thermal
from simulators.world.truth import Truth
from simulators.world.turning import TurnCrash, first_turn_crash
from simulators.world.workpiece import Workpiece
from twin.geometry import point
from twin.true_machine import TrueMachine, draw_machine, perfect_machine

MOUNT = "mount"


@dataclass(frozen=True)
class Collision:
    time_s: float
    body_a: str
    body_b: str


class World:
    """Physics without sockets, threads or time of its own: whoever holds the clock calls `advance_to`."""

    def __init__(self, scenario: Scenario) -> None:
        settings = scenario.settings
        machine = true_machine(scenario)
        thermal = Thermal(
            settings.temperatures,
            scenario.machine.model.ranges_mm,
            point(scenario.machine.tool(settings.tool)),
            settings.seed,
        )
        mount = MountPhysics(settings.mount_behaviour, settings.seed, self._look_ahead)
        self.scenario = scenario
        self.now = 0.0
        self.collisions: list[Collision] = []
        self.mounts = {MOUNT: mount}
        self.workpiece = Workpiece(scenario, mount)
        self.controller = Controller(
            scenario,
            machine_field=None if machine.is_perfect else machine.deviation,
            workpiece=self.workpiece,
            thermal=thermal,
            on_motion=self._look_ahead,
            on_collision=self._record,
        )
        self.truth = Truth(machine, scenario.machine.model, self.controller.banks, lambda: thermal.field(self.now))
        self._turn_crash: TurnCrash | None = None

    def advance_to(self, instant_s: float) -> None:
        """Move everything on to `instant_s`; the past is left alone."""
        if instant_s <= self.now:
            return
        if self._turn_crash is not None and self._turn_crash.time_s <= instant_s:
            self._crash_turning(self._turn_crash)
        self._move_to(instant_s)

    def place_artefact(self, station: int) -> None:
        """The operator's hand: mount and bar stand at `station` (from 1) afterwards. CommandRejected elsewhere."""
        self.workpiece.place(station)
        self._look_ahead()

    def _move_to(self, instant_s: float) -> None:
        self.now = instant_s
        for mount in self.mounts.values():
            mount.now_s = instant_s
        self.controller.advance_to(instant_s)

    def _look_ahead(self) -> None:
        """A turning artefact is watched against the probe; a standing one is no concern of this."""
        mount = self.mounts[MOUNT]
        self._turn_crash = None
        if mount.settled_s > self.now:
            self._turn_crash = first_turn_crash(self.workpiece, self.controller, self.now, mount.settled_s)

    def _crash_turning(self, crash: TurnCrash) -> None:
        self._move_to(max(crash.time_s, self.now))
        self._turn_crash = None
        self._record(crash.moving, crash.obstacle)
        self.controller.fail(f"collision: {crash.moving} with {crash.obstacle}")
        for mount in self.mounts.values():
            mount.halt()
        self._turn_crash = None

    def _record(self, body_a: str, body_b: str) -> None:
        self.collisions.append(Collision(self.now, body_a, body_b))


def true_machine(scenario: Scenario) -> TrueMachine:
    """Drawn by the scenario's own seed, so that it is the same machine in every world of that scenario."""
    settings, truth = scenario.settings, scenario.settings.truth
    if settings.ideal:
        return perfect_machine(scenario.machine, settings.tool)
    rng = generator(truth.seed, "machine")
    drawn = draw_machine(
        scenario.machine,
        settings.tool,
        order=truth.legendre_order,
        scale=truth.scale,
        with_deflection=truth.deflection,
        rng=rng,
    )
    return aged(drawn, scenario.machine, settings.ageing)
