"""Simulated world: one machine with its mounts and artefacts, advanced by an external clock."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from drivers.errors import CommandRejected, InputError
from drivers.roles import TableImage
from simulators.scenario import Misplacement, Scenario
from simulators.world.ageing import apply_ageing, collision_in_run
from simulators.world.controller import Controller
from simulators.world.field import FieldOfMany, TableField
from simulators.world.field_changes import FieldChanges
from simulators.world.mount import MountPhysics
from simulators.world.noise import generator
from simulators.world.thermal_effects import ThermalEffects
from simulators.world.turn_collisions import (
    TurnCrash,
    first_mount_collision,
    first_table_collision,
    first_turn_crash,
)
from simulators.world.workpiece import Workpiece
from simulators.world.worktable import Worktable
from twin.collision.geometry import point
from twin.machine.error_model import ErrorModel
from twin.machine.true_machine import TrueMachine, draw_machine, perfect_machine
from twin.machine.volumetric import evaluation_grid, volumetric_error

MOUNT = "mount"


@dataclass(frozen=True)
class Collision:
    time_s: float
    body_a: str
    body_b: str


def mount_name(station: int) -> str:
    """Return the name of the mount fixed at `station`."""
    return f"{MOUNT} {station}"


class World:
    """Physics of the simulated machine.

    The world has no clock of its own: the owner of the clock calls `advance_to`.
    """

    def __init__(self, scenario: Scenario) -> None:
        settings = scenario.settings
        machine = true_machine(scenario)
        thermal = ThermalEffects(
            settings.temperatures,
            scenario.machine.model.ranges_mm,
            point(scenario.machine.tool(settings.tool)),
            settings.seed,
        )
        self.changes = FieldChanges(thermal, collision_in_run(machine, settings.ageing))
        self.scenario = scenario
        self.now = 0.0
        self.collisions: list[Collision] = []
        self.mounts = self._mounts(scenario)
        self.table = Worktable(scenario, list(self.mounts.values()))
        self.controller = Controller(
            scenario,
            machine_field=None if machine.is_perfect else machine.deviation,
            table=self.table,
            changes=self.changes,
            on_motion=self._expect_change,
            on_collision=self._record,
        )
        self.truth = MachineTruth(
            machine, scenario.machine.model, self.controller.applied_tables, lambda: self.changes.field(self.now)
        )
        self._turn_crash: TurnCrash | None = None
        self._looked_ahead = True

    def advance_to(self, instant_s: float) -> None:
        """Advance the whole simulation to machine time `instant_s`. If it has already reached that instant, the method
        does nothing.
        """
        if instant_s <= self.now:
            return
        crash = self._turn_crash if self._looked_ahead else self.turn_crash
        # The state must stop at the instant of the collision, not at the one that was asked for.
        if crash is not None and crash.time_s <= instant_s:
            self._crash_turning(crash)
        self._move_to(instant_s)

    @property
    def turn_crash(self) -> TurnCrash | None:
        """First collision of a turning mount if no further command intervenes, or None if there is no collision.

        The collision is computed when the property is first read after a motion has begun or changed. Two motions that
        begin at the same instant, such as the motions of both axes of a mount, are therefore considered together.
        """
        if not self._looked_ahead:
            self._turn_crash, self._looked_ahead = self._look_ahead(), True
        return self._turn_crash

    @property
    def workpiece(self) -> Workpiece:
        """Workpiece whose artefact the operator can move; the first one if every station has its own artefact."""
        return self.table.workpiece

    def mount_at(self, station: int) -> MountPhysics:
        """Return the mount that turns the workpiece at `station`. Raises CommandRejected if the station
        does not exist.
        """
        if self.scenario.mount_count == 0:
            raise CommandRejected("there is no mount", hint="the artefact is placed by hand")
        if self.scenario.mount_count == 1:
            return self.mounts[MOUNT]
        if mount_name(station) not in self.mounts:
            raise CommandRejected(f"there is no station {station}", hint=f"stations are 1 to {len(self.mounts)}")
        return self.mounts[mount_name(station)]

    def place_artefact(self, station: int) -> None:
        """Move the artefact to the station number `station`, counted from 1, as the operator does.

        Raises CommandRejected if the station does not exist or if every station has its own artefact.
        """
        self.table.place_artefact(station)
        self._expect_change()

    def place_by_hand(
        self, station: int, azimuth_deg: float, elevation_deg: float, misplaced: Misplacement | None = None
    ) -> None:
        """Place the artefact by hand at `station`, with the errors of the scenario and the gross error `misplaced`.

        Raises CommandRejected if the station does not exist or if the artefact is held by a mount.
        """
        self.table.place_by_hand(station, (azimuth_deg, elevation_deg), misplaced)
        self._expect_change()

    def remove_artefact(self) -> None:
        """Take the artefact that is placed by hand off the machine."""
        self.table.remove_artefact()
        self._expect_change()

    def _mounts(self, scenario: Scenario) -> dict[str, MountPhysics]:
        settings = scenario.settings
        angles = settings.mounts_deg or [(0.0, 0.0)] * scenario.mount_count
        names = (
            [mount_name(station) for station in range(1, scenario.mount_count + 1)]
            if settings.own_mounts
            else [MOUNT] * scenario.mount_count
        )
        return {
            name: MountPhysics(settings.mount_behaviour, settings.seed, self._expect_change, name=name, start_deg=start)
            for name, start in zip(names, angles, strict=True)
        }

    def _move_to(self, instant_s: float) -> None:
        self.now = instant_s
        for mount in self.mounts.values():
            mount.now_s = instant_s
        self.controller.advance_to(instant_s)

    def _expect_change(self) -> None:
        """Invalidate the forecast of collisions."""
        self._looked_ahead = False

    def _look_ahead(self) -> TurnCrash | None:
        """Return the first collision of a turning mount with the probe, the table or another mount, or None.

        Mounts at rest are skipped.
        """
        crashes: list[TurnCrash] = []
        pieces = self.table.pieces
        for piece in pieces:
            ends_s = piece.mount.settled_s
            if ends_s <= self.now:
                continue
            others = [other for other in pieces if other is not piece]
            met = [
                first_turn_crash(piece, self.controller, self.now, ends_s),
                first_table_collision(piece, self.now, ends_s),
            ]
            met += [first_mount_collision(piece, other, self.now, ends_s) for other in others]
            crashes += [crash for crash in met if crash is not None]
        return min(crashes, key=lambda crash: crash.time_s, default=None)

    def _crash_turning(self, crash: TurnCrash) -> None:
        self._move_to(max(crash.time_s, self.now))
        self._record(crash.moving, crash.obstacle)
        self.controller.fail(f"collision: {crash.moving} with {crash.obstacle}")
        for mount in self.mounts.values():
            mount.halt()
        # `halt` has invalidated the forecast. While the mounts brake in contact, the same collision must not be
        # recorded again.
        self._turn_crash, self._looked_ahead = None, True

    def _record(self, body_a: str, body_b: str) -> None:
        self.collisions.append(Collision(self.now, body_a, body_b))


def true_machine(scenario: Scenario) -> TrueMachine:
    """Return the true machine of `scenario`, whose errors are drawn at random unless the scenario is ideal. All worlds
    of one scenario have the same machine.
    """
    settings, truth = scenario.settings, scenario.settings.truth
    if settings.ideal:
        return perfect_machine(scenario.machine, settings.tool)
    # Numbers of their own, so that nothing else that is drawn changes the machine.
    rng = generator(truth.seed, "machine")
    drawn = draw_machine(
        scenario.machine,
        settings.tool,
        order=truth.legendre_order,
        scale=truth.scale,
        with_deflection=truth.deflection,
        rng=rng,
    )
    return apply_ageing(drawn, scenario.machine, settings.ageing)


class MachineTruth:
    """True error of the machine at its present temperature, and after a collision if there was one.

    `banks` maps the numbers of the controller's banks to their tables as it applies them; it is shared with the
    controller and not copied. `change` is a function that returns the present change of the deviation field, or None.
    The thermal growth of spindle and ram is excluded: it shifts the tip equally at all positions, like a new zero
    point, and a compensation table need not correct such a shift.
    """

    def __init__(
        self,
        machine: TrueMachine,
        nominal: ErrorModel,
        banks: Mapping[int, TableImage],
        change: Callable[[], FieldOfMany | None] = lambda: None,
    ) -> None:
        self.machine = machine
        self._banks = banks
        self._change = change
        self._grid = evaluation_grid(nominal.ranges_mm)

    def true_volumetric_error(self, bank: int | None = None) -> tuple[float, float]:
        """Return two rms lengths of the true error in µm with the compensation table of `bank`, on a grid of 60×20×20
        points in the workspace.

        The first value is the raw error, and the second is the aligned error, which remains after the best-fitting
        rigid motion is removed. If `bank` is None or 0, both values are errors without a compensation table. Raises
        InputError if the bank is empty.
        """
        displayed = self._grid
        correction = np.zeros_like(displayed)
        if bank:
            if bank not in self._banks:
                raise InputError(f"bank {bank} holds no table", hint=f"filled banks: {sorted(self._banks)}")
            correction = TableField(self._banks[bank]).at_many(displayed)
        # The error of the machine is that of the place where the axes really are.
        bare = displayed + correction
        deviation = correction + self.machine.deviation(bare)
        changed = self._change()
        if changed is not None:
            deviation = deviation + changed(bare)
        result = volumetric_error(displayed + self.machine.tool_offset, deviation)
        return result.raw_um, result.aligned_um
