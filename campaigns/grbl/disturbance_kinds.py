"""Kinds of disturbance of a run over a serial line, and the permitted consequences of each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from random import Random

from campaigns.grbl.scene import DisturbedMachine
from drivers.roles import MotionState, Permission

ENDS_AFTER_S = 60.0
"""Machine time in s after the disturbance at which a run that goes on is aborted, so that the trial ends."""
RELEASED_AFTER_S = 8.0
BRAKED_AFTER_S = 2.0
LIMIT_SWITCH = "limit switch"
END_REASON = "end of the trial"


@dataclass(frozen=True)
class Disturbance:
    """Disturbance of one kind. `apply` disturbs the scene now.

    `reasons` are words of which the reason of the run must contain one. If `ends_motion` is True, a run whose axes move
    at the disturbance must end because of it. If `stands` is True, the axes must not move from `BRAKED_AFTER_S` after
    the disturbance until `RELEASED_AFTER_S`. If `reachable` is False, no stop can be sent afterwards.
    """

    apply: Callable[[DisturbedMachine, Random], None]
    reasons: tuple[str, ...]
    ends_motion: bool = True
    stands: bool = False
    reachable: bool = True


def _abort(scene: DisturbedMachine, _: Random) -> None:
    assert scene.supervisor is not None
    scene.supervisor.request_abort("SIGINT")


def _hold(scene: DisturbedMachine, _: Random) -> None:
    scene.controller.received(b"!")


def _hold_and_release(scene: DisturbedMachine, rng: Random) -> None:
    _hold(scene, rng)
    _later(scene, RELEASED_AFTER_S, lambda: scene.controller.received(b"~"))


def _reset(scene: DisturbedMachine, _: Random) -> None:
    scene.controller.received(b"\x18")


def _reboot(scene: DisturbedMachine, _: Random) -> None:
    scene.controller.reboot()


def _limit_switch(scene: DisturbedMachine, _: Random) -> None:
    scene.world.controller.fail(LIMIT_SWITCH)
    scene.controller.on_advance(scene.clock.now())


def _door(scene: DisturbedMachine, _: Random) -> None:
    scene.world.controller.granted[Permission.DOORS_CLOSED] = False
    scene.controller.on_advance(scene.clock.now())


def _unplug(scene: DisturbedMachine, _: Random) -> None:
    scene.cable.pull()


def _replug(scene: DisturbedMachine, rng: Random) -> None:
    scene.cable.pull()

    def plug() -> None:
        scene.cable.unplugged = False

    _later(scene, rng.uniform(0.05, 5.0), plug)


def _stall(scene: DisturbedMachine, rng: Random) -> None:
    scene.cable.stalled_until_s = scene.clock.now() + rng.uniform(0.5, 6.0)


def _late(scene: DisturbedMachine, rng: Random) -> None:
    scene.cable.late_s = rng.uniform(0.05, 1.5)

    def recover() -> None:
        scene.cable.late_s = 0.0

    _later(scene, rng.uniform(0.5, 10.0), recover)


def _garble(scene: DisturbedMachine, rng: Random) -> None:
    def change(line: bytes) -> bytes:
        scene.cable.change_line = lambda other: other
        at = rng.randrange(max(len(line) - 2, 1))
        return line[:at] + bytes((rng.randrange(0x80, 0x100),)) + line[at + 1 :]

    scene.cable.change_line = change


def _lose_line(scene: DisturbedMachine, _: Random) -> None:
    def change(_: bytes) -> bytes:
        scene.cable.change_line = lambda other: other
        return b""

    scene.cable.change_line = change


def _lose_byte(scene: DisturbedMachine, _: Random) -> None:
    scene.cable.lose_byte = True


def _later(scene: DisturbedMachine, after_s: float, action: Callable[[], None]) -> None:
    scene.clock.at(scene.clock.now() + after_s, action)


NOISE = (
    "garbled",
    "no answer",
    "no line waits",
    "no status report",
    "refused",
    "probe results",
    "off its target",
)
KINDS: dict[str, Disturbance] = {
    "abort": Disturbance(_abort, ("SIGINT",)),
    "hold": Disturbance(_hold, ("held at the machine", "Hold"), stands=True),
    "hold and release": Disturbance(_hold_and_release, (), ends_motion=False, stands=True),
    "reset": Disturbance(_reset, ("restarted", "alarm", "referenced", "refused"), stands=True),
    "reboot": Disturbance(_reboot, ("restarted", "alarm", "referenced", "refused"), stands=True),
    "limit switch": Disturbance(_limit_switch, ("limit switch", "restarted", "alarm"), stands=True),
    "door": Disturbance(_door, ("door",), stands=True),
    "unplugged": Disturbance(_unplug, ("serial port",), reachable=False),
    "replugged": Disturbance(_replug, ("serial port", "no answer", *NOISE), ends_motion=False),
    "stalled": Disturbance(_stall, ("accepts no data", *NOISE), ends_motion=False),
    "late": Disturbance(_late, NOISE, ends_motion=False),
    "garbled line": Disturbance(_garble, NOISE, ends_motion=False),
    "lost line": Disturbance(_lose_line, NOISE, ends_motion=False),
    "lost byte": Disturbance(_lose_byte, NOISE, ends_motion=False),
}


@dataclass
class Observation:
    """Observation of one disturbed run. Times are in s of machine time, positions in mm."""

    kind: str
    began_s: float
    moving: bool
    touches: int
    braked: tuple[float, ...] | None = None
    released: tuple[float, ...] | None = None


def disturb(scene: DisturbedMachine, kind: str, rng: Random) -> Observation:
    """Disturb the run now. If the disturbance does not end the run, request its abort later."""
    assert scene.probe is not None
    moving = scene.world.controller.motion is MotionState.MOVING
    seen = Observation(kind, scene.clock.now(), moving, scene.probe.touches)
    if KINDS[kind].stands:
        _later(scene, BRAKED_AFTER_S, lambda: setattr(seen, "braked", tuple(scene.position)))
        _later(scene, RELEASED_AFTER_S - 0.5, lambda: setattr(seen, "released", tuple(scene.position)))

    def end() -> None:
        if scene.supervisor is not None:
            scene.supervisor.request_abort(END_REASON)

    _later(scene, ENDS_AFTER_S, end)
    KINDS[kind].apply(scene, rng)
    return seen
