"""Search for contacts of the stylus tip and collisions of other bodies along the path of a motion command, before the
motion begins.
"""

from __future__ import annotations

from collections.abc import Collection

from drivers.errors import CommandRejected
from simulators.world.contact import ContactSolver
from simulators.world.motion_forecast import Crash, MotionCommand, MoveKind, PathEvents, earliest, tip_crash
from simulators.world.trigger import Trigger
from simulators.world.workpiece import WorkpieceSnapshot
from twin.collision.bodies import TIP
from twin.collision.geometry import Point, translate_point

STEM = "stem"


class PathLookahead:
    """Search for the events along a path: contacts of the stylus tip, trips of the probe, and collisions.

    Contacts of the tip are calculated exactly. Collisions of other bodies are searched along the nominal path of the
    tip, which differs from the true path by less than 0.1 mm.
    """

    def __init__(
        self, tool_offset: Point, contacts: ContactSolver, trigger: Trigger, *, trips_on_bodies: bool = False
    ) -> None:
        """If `trips_on_bodies` is True, the probe also trips on the other parts of the artefact and on the table, in a
        touch or a guarded move, and if the stem meets a body that the tip does not meet, because a force on the stem
        deflects the stylus too. Otherwise any contact of the tip or the stem with them is a collision.
        """
        self._tool = tool_offset
        self._contacts = contacts
        self._trigger = trigger
        self._trips_on_bodies = trips_on_bodies

    def events_on(
        self, command: MotionCommand, snapshot: WorkpieceSnapshot, resting: int | None, touch: int
    ) -> PathEvents:
        """Return the events on the path of `command`: a trip of the probe, a collision, and the separation of a
        deflected probe.

        `resting` is the number of the ball that deflects the probe at the start, or None if the probe is not deflected.
        `snapshot` contains the balls and all bodies. `touch` is the number that selects the noise of the trip. Raises
        CommandRejected if the probe is already deflected and the command is a touch, or a guarded move that would press
        the tip further against the ball.
        """
        free_mm, pressed = self._from_rest(command, snapshot, resting)
        contact = self._contacts.first(command.path, snapshot, resting)
        if contact is None:
            met = self._first_collision(command, snapshot, None, resting)
            tripping = self._trips_on_bodies and command.kind is not MoveKind.POSITIONING
            if tripping and met is not None and met.moving in (TIP, STEM):
                return self._trip_on_body(command, snapshot, met, pressed, free_mm)
            return PathEvents(None, earliest(pressed, met), free_mm)
        if command.kind is MoveKind.POSITIONING:
            met = tip_crash(snapshot.ball_names[contact.ball], max(contact.distance, 0.0))
            swept = self._first_collision(command, snapshot, met.distance, resting)
            return PathEvents(None, earliest(pressed, met, swept), free_mm)
        trip_mm = max(contact.distance + self._trigger.travel_mm(command.path.direction, touch), 0.0)
        # Braking distance after the trip: v² / (2 a).
        stopped = trip_mm + 0.5 * command.speed**2 / command.acceleration
        # A probe that is pressed further than its overtravel breaks, even if the trip came in time.
        spent = tip_crash(snapshot.ball_names[contact.ball], contact.distance + self._trigger.overtravel_mm)
        # until the axes stand, since other bodies move on while they brake
        swept = self._first_collision(command, snapshot, stopped, contact.ball)
        return PathEvents(trip_mm, earliest(spent, swept), free_mm)

    def _trip_on_body(
        self, command: MotionCommand, snapshot: WorkpieceSnapshot, met: Crash, pressed: Crash | None, free_mm: float
    ) -> PathEvents:
        """Return the events of a touch or a guarded move in which the tip meets something other than a ball, or
        the stem meets anything.

        The probe trips as it does on a ball. It is a collision only if the axes do not stop within the overtravel of
        the probe, or if another body collides.
        """
        stopped = met.distance + 0.5 * command.speed**2 / command.acceleration
        spent = Crash(met.distance + self._trigger.overtravel_mm, met.moving, met.obstacle)
        own = {(TIP, met.obstacle), (STEM, met.obstacle)}
        swept = self._first_collision(command, snapshot, stopped, None, ignored=own)
        return PathEvents(max(met.distance, 0.0), earliest(pressed, spent, swept), free_mm)

    def _from_rest(
        self, command: MotionCommand, snapshot: WorkpieceSnapshot, resting: int | None
    ) -> tuple[float, Crash | None]:
        """Return the path distance in mm at which a deflected probe separates (0 if it is not deflected), and the
        crash.

        The crash is None unless the motion deflects the probe beyond its overtravel before it separates.
        """
        if resting is None:
            return 0.0, None
        centre = snapshot.balls[resting]
        if command.kind is MoveKind.TOUCH:
            raise CommandRejected("the probe is deflected before the touch", hint="back off first")
        if not self._contacts.pressing(command.path, centre):
            return self._contacts.leaving(command.path, centre), None
        if command.kind is MoveKind.GUARDED:
            raise CommandRejected("the probe is deflected and the move would press on", hint="move it free")
        deeper = self._contacts.deeper(command.path, centre, self._trigger.overtravel_mm)
        pressed = None if deeper is None else tip_crash(snapshot.ball_names[resting], deeper)
        return self._contacts.leaving(command.path, centre), pressed

    def _first_collision(
        self,
        command: MotionCommand,
        snapshot: WorkpieceSnapshot,
        until_mm: float | None,
        touched: int | None,
        ignored: Collection[tuple[str, str]] = (),
    ) -> Crash | None:
        """Return the first collision of any two bodies, or None if there is none. The pairs of names in `ignored` do
        not count.

        Contact of the tip with a ball does not count. The stem may touch the ball that the tip touches, because it
        deflects with the tip.
        """
        path = command.path
        length = path.length if until_mm is None else min(until_mm, path.length)
        if length == 0.0:
            return None
        allowed_contacts = snapshot.allowed_contacts.union(ignored)
        if touched is not None:
            allowed_contacts = allowed_contacts | {(STEM, snapshot.ball_names[touched])}
        start, end = translate_point(path.start, self._tool), translate_point(path.at(length), self._tool)
        hit = snapshot.scene.first_hit(start, end, ignored=allowed_contacts)
        return None if hit is None else Crash(hit.fraction * length, hit.moving, hit.obstacle)
