"""All workpieces (mounts and their artefacts) on the machine table.

There is either one mount that is moved with its artefact, or one mount at every station.
"""

from __future__ import annotations

from drivers.errors import CommandRejected
from simulators.scenario import Scenario
from simulators.world.mount import MountPhysics
from simulators.world.noise import generator
from simulators.world.workpiece import Workpiece, WorkpieceSnapshot, true_artefact
from twin.artefact.artefact import Artefact
from twin.collision.bodies import TABLE
from twin.collision.collision import Scene


class Worktable:
    """Workpieces (mounts and their artefacts) on the machine table: one workpiece at each station or, if there is only
    one mount, a single workpiece.
    """

    def __init__(self, scenario: Scenario, mounts: list[MountPhysics]) -> None:
        self._scenario = scenario
        self._stations = len(scenario.settings.stations_mm)
        self._placements = 0
        self._cached: tuple[tuple[WorkpieceSnapshot, ...], WorkpieceSnapshot] | None = None
        self._at = scenario.settings.standing_at
        if scenario.settings.own_mounts:
            self._pieces = [self._own(scenario, mount, number) for number, mount in enumerate(mounts, start=1)]
        else:
            artefact = true_artefact(scenario.artefact, scenario.settings.artefact_truth)
            self._pieces = [Workpiece(scenario, mounts[0], artefact, self._at)]
            self._place(self._pieces[0], self._at)

    def _own(self, scenario: Scenario, mount: MountPhysics, station: int) -> Workpiece:
        piece = Workpiece(scenario, mount, self._first_artefact(station), station, f" at station {station}")
        piece.place(station, generator(scenario.settings.seed, f"place of mount {station}"))
        return piece

    def _first_artefact(self, station: int) -> Artefact | None:
        """Return the artefact that the mount at `station` carries at the start, or None."""
        truth = self._scenario.settings.artefact_truth
        if self._scenario.artefacts:
            return true_artefact(self._scenario.artefacts[station - 1], truth, f"artefact {station}")
        return true_artefact(self._scenario.artefact, truth) if station == self._at else None

    @property
    def pieces(self) -> tuple[Workpiece, ...]:
        return tuple(self._pieces)

    @property
    def workpiece(self) -> Workpiece:
        """Workpiece (mount and artefact) whose artefact the operator can move; if every station has its own artefact,
        the first workpiece.
        """
        if len(self._pieces) == 1 or self._scenario.artefacts:
            return self._pieces[0]
        return self._pieces[self._at - 1]

    @property
    def ball_radius_mm(self) -> float:
        return self.workpiece.artefact.ball_radius_mm

    def place_artefact(self, station: int) -> None:
        """Move the artefact to the station number `station`, as the operator does.

        Raises CommandRejected if the station does not exist or if every station has its own artefact.
        """
        if not 1 <= station <= self._stations:
            raise CommandRejected(f"there is no station {station}", hint=f"stations are 1 to {self._stations}")
        if self._scenario.artefacts:
            raise CommandRejected("every station has its own artefact: none can be moved")
        piece = self.workpiece
        self._at = station
        if len(self._pieces) > 1:
            artefact = piece.artefact
            piece.carry(None)
            piece = self.workpiece
            piece.carry(artefact)
        self._place(piece, station)

    def snapshot(self, now_s: float) -> WorkpieceSnapshot:
        """Return all balls and bodies on the machine table at the instant `now_s`.

        The result is cached while no workpiece (mount with its artefact) turns, moves or changes its temperature.
        """
        if len(self._pieces) == 1:
            return self._pieces[0].snapshot(now_s)
        parts = tuple(piece.snapshot(now_s) for piece in self._pieces)
        if self._cached is None or any(a is not b for a, b in zip(self._cached[0], parts, strict=True)):
            self._cached = (parts, self._combine(parts))
        return self._cached[1]

    def _combine(self, parts: tuple[WorkpieceSnapshot, ...]) -> WorkpieceSnapshot:
        first, *others = parts
        bodies = (*first.bodies, *(body for part in others for body in part.bodies if body.name != TABLE))
        return WorkpieceSnapshot(
            pose=parts[self._pieces.index(self.workpiece)].pose,
            balls=tuple(ball for part in parts for ball in part.balls),
            ball_names=tuple(name for part in parts for name in part.ball_names),
            bodies=bodies,
            scene=Scene(self.workpiece.probe_bodies, bodies),
        )

    def _place(self, piece: Workpiece, station: int) -> None:
        piece.place(station, generator(self._scenario.settings.seed, f"placement {self._placements}"))
        self._placements += 1
