"""All workpieces on the machine table.

There is one mount that is moved with its artefact, or one mount at every station, or no mount at all: the artefact is
then placed by hand.
"""

from __future__ import annotations

from drivers.errors import CommandRejected
from simulators.scenario import Misplacement, MountBehaviour, Scenario
from simulators.world.mount import MountPhysics
from simulators.world.noise import generator
from simulators.world.workpiece import Workpiece, WorkpieceSnapshot, true_artefact
from twin.artefact.artefact import Artefact
from twin.collision.bodies import TABLE
from twin.collision.collision import Scene


class Worktable:
    """Workpieces on the machine table: one workpiece at each station or, if there is only one mount, a single
    workpiece.
    """

    def __init__(self, scenario: Scenario, mounts: list[MountPhysics]) -> None:
        self._scenario = scenario
        self._stations = len(scenario.settings.stations_mm)
        self._placements = 0
        self._cached: tuple[tuple[WorkpieceSnapshot, ...], WorkpieceSnapshot] | None = None
        self._at = scenario.settings.standing_at
        self._behaviour, self._hand = scenario.settings.mount_behaviour, scenario.settings.placed_by_hand
        if self._hand is not None:
            self._by_hand = true_artefact(scenario.artefact, scenario.settings.artefact_truth)
            self._pieces = [Workpiece(scenario, _support((0.0, 0.0)), None, self._at)]
        elif scenario.settings.own_mounts:
            self._pieces = [self._own(scenario, mount, number) for number, mount in enumerate(mounts, start=1)]
        else:
            artefact = true_artefact(scenario.artefact, scenario.settings.artefact_truth)
            self._pieces = [Workpiece(scenario, mounts[0], artefact, self._at)]
            self._place(self._pieces[0], self._at)

    def _own(self, scenario: Scenario, mount: MountPhysics, station: int) -> Workpiece:
        piece = Workpiece(scenario, mount, self._first_artefact(station), station, f" at station {station}")
        rng, behaviour = generator(scenario.settings.seed, f"place of mount {station}"), self._behaviour
        piece.place(station, rng, behaviour.place_error_mm, behaviour.place_error_deg)
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
        """Workpiece whose artefact the operator can move; the first one if every station has its own artefact."""
        if len(self._pieces) == 1 or self._scenario.artefacts:
            return self._pieces[0]
        return self._pieces[self._at - 1]

    @property
    def ball_radius_mm(self) -> float:
        return self._scenario.artefact.ball_radius_mm

    def place_artefact(self, station: int) -> None:
        """Move the artefact to the station number `station`, as the operator does.

        Raises CommandRejected if the station does not exist or if every station has its own artefact.
        """
        if not 1 <= station <= self._stations:
            raise CommandRejected(f"there is no station {station}", hint=f"stations are 1 to {self._stations}")
        if self._scenario.artefacts:
            raise CommandRejected("every station has its own artefact: none can be moved")
        if self._hand is not None:
            raise CommandRejected("the artefact has no mount", hint="it is placed by hand, in a position")
        piece = self.workpiece
        self._at = station
        if len(self._pieces) > 1:
            artefact = piece.artefact
            piece.carry(None)
            piece = self.workpiece
            piece.carry(artefact)
        self._place(piece, station)

    def place_by_hand(self, station: int, angles_deg: tuple[float, float], misplaced: Misplacement | None) -> None:
        """Place the artefact at `station` with the azimuth and the elevation `angles_deg`, as a person does.

        `misplaced` is a gross error of this placement; if it is None, that of the scenario applies. Raises
        CommandRejected if the station does not exist or if the artefact is held by a mount.
        """
        if self._hand is None:
            raise CommandRejected("the artefact is held by a mount", hint="ask for its station only")
        if not 1 <= station <= self._stations:
            raise CommandRejected(f"there is no station {station}", hint=f"stations are 1 to {self._stations}")
        self._at, piece = station, self._pieces[0]
        piece.mount = _support(angles_deg)
        piece.carry(self._by_hand)
        rng = generator(self._scenario.settings.seed, f"placement {self._placements}")
        self._placements += 1
        piece.place(station, rng, self._hand.error_mm, self._hand.error_deg)
        gross = misplaced or next((one for one in self._hand.misplaced if one.placement == self._placements), None)
        if gross is not None:
            piece.shift(gross.off_mm, gross.off_deg)

    def remove_artefact(self) -> None:
        """Take the artefact off the machine. Raises CommandRejected if it is held by a mount."""
        if self._hand is None:
            raise CommandRejected("the artefact is held by a mount: it cannot be taken away")
        self._pieces[0].carry(None)

    def snapshot(self, now_s: float) -> WorkpieceSnapshot:
        """Return all balls and bodies on the machine table at the instant `now_s`.

        The result is cached while no workpiece turns, moves or changes its temperature.
        """
        if len(self._pieces) == 1:
            return self._pieces[0].snapshot(now_s)
        parts = tuple(piece.snapshot(now_s) for piece in self._pieces)
        if self._cached is None or any(a is not b for a, b in zip(self._cached[0], parts, strict=True)):
            self._cached = (parts, self._combine(parts))
        return self._cached[1]

    def _combine(self, parts: tuple[WorkpieceSnapshot, ...]) -> WorkpieceSnapshot:
        first, *others = parts
        # All workpieces stand on one table, which is in the snapshot of each.
        bodies = (*first.bodies, *(body for part in others for body in part.bodies if body.name != TABLE))
        return WorkpieceSnapshot(
            pose=parts[self._pieces.index(self.workpiece)].pose,
            balls=tuple(ball for part in parts for ball in part.balls),
            ball_names=tuple(name for part in parts for name in part.ball_names),
            bodies=bodies,
            scene=Scene(self.workpiece.probe_bodies, bodies),
        )

    def _place(self, piece: Workpiece, station: int) -> None:
        rng = generator(self._scenario.settings.seed, f"placement {self._placements}")
        behaviour = self._behaviour
        piece.place(station, rng, behaviour.place_error_mm, behaviour.place_error_deg)
        self._placements += 1


def _support(angles_deg: tuple[float, float]) -> MountPhysics:
    """Return an exact mount that never turns: the support on which a person puts the artefact."""
    exact = MountBehaviour(index_error_deg=0.0, wobble_um=0.0)
    return MountPhysics(exact, 0, lambda: None, start_deg=angles_deg)
