"""Machine that an instrument observes: it moves without workpiece and artefact, with all its true errors.

The machine of a world is observed without changing it: the clock of the world does not advance and its axes stay where
they are. The instrument looks ahead from the present machine time, so the machine warms up during the observation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from drivers.errors import InputError
from simulators.scenario import AxisBehaviour
from simulators.world.field import TableField, TipShift
from simulators.world.lost_motion import PlayOperator
from simulators.world.world import World
from twin.arrays import Array
from twin.collision.geometry import point

Displacement = Callable[[Array, Array], Array]
"""Function of n axis positions (n, 3) in mm and of the n instants (n,) in s at which the machine is there; it returns
the displacements (n, 3) in mm of the tip from its nominal place, without lost motion."""

RAPID_MM_PER_S = 50.0
"""Speed between two targets, 3 m/min."""


@dataclass(frozen=True, eq=False)
class MachineUnderTest:
    """Machine that stands before an instrument at the instant `now_s`.

    `displaced` gives its position-dependent error and its thermal growth, `behaviour` its lost motion and its
    repeatability, which is drawn from `seed`. `air_c` is the temperature of the ambient air in °C at an instant in s.
    """

    displaced: Displacement
    behaviour: AxisBehaviour
    air_c: Callable[[float], float]
    now_s: float = 0.0
    seed: int = 0

    def stops(self, path_mm: Array, at_s: Array) -> Array:
        """Return the displacements (n, 3) in mm of the tip at n axis positions (n, 3), at each of which the axes stop.

        `at_s` (n,) are the instants in s of the stops. The first position only takes up the play: the axes come from
        nowhere.
        """
        return self._moved(path_mm, at_s, self.behaviour)

    def contour(self, path_mm: Array, at_s: Array) -> Array:
        """Return the displacements (n, 3) in mm of the tip on a continuous path through axis positions (n, 3).

        The axes do not come to rest, so they do not scatter from point to point as after a positioning.
        """
        return self._moved(path_mm, at_s, self.behaviour.model_copy(update={"repeatability_um": 0.0}))

    def _moved(self, path_mm: Array, at_s: Array, behaviour: AxisBehaviour) -> Array:
        play = PlayOperator(behaviour, self.seed)
        lag = [play.after(point(start), point(end)) for start, end in pairwise(path_mm)]
        return np.asarray(self.displaced(path_mm, at_s) + np.array([(0.0, 0.0, 0.0), *lag]))


def machine_of_world(world: World, bank: int | None, seed: int) -> MachineUnderTest:
    """Return the machine of `world` as it is now, with the compensation table of `bank` as the controller applies it.

    If `bank` is None or 0, no table acts. `seed` is that of the repeatability. Raises InputError if the bank is empty.
    """
    tables, changes = world.controller.applied_tables, world.changes
    if bank and bank not in tables:
        raise InputError(f"bank {bank} holds no table", hint=f"filled banks: {sorted(tables)}", key="bank")
    true = world.truth.machine
    shift = TipShift(None if true.is_perfect else true.deviation)
    shift.table = TableField(tables[bank]) if bank else None
    shift.homing = world.controller.homing_offset_mm

    def displaced(path_mm: Array, at_s: Array) -> Array:
        found: Array = shift.field_at_many(path_mm) + np.array(shift.homing)
        correction = np.zeros_like(path_mm) if shift.table is None else shift.table.at_many(path_mm)
        bare = path_mm + correction + np.array(shift.homing)
        for number, instant_s in enumerate(at_s.tolist()):
            found[number] += changes.thermal.drift_mm(instant_s)
            changed = changes.field(instant_s)
            if changed is not None:
                found[number] += changed(bare[number : number + 1])[0]
        return found

    behaviour = world.scenario.settings.axes
    return MachineUnderTest(displaced, behaviour, changes.thermal.state.ambient_c, world.now, seed)
