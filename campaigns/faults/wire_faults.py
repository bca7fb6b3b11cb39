"""Faults of the wire to the controller as the run sees them: errors of the driver, at once or after the command has had
its effect.
"""

from __future__ import annotations

from typing import Any

from numpy.random import Generator

from campaigns.faults.controller_faults import COMMANDS, duration_s
from campaigns.faults.fault_scene import FaultScene
from campaigns.faults.faulty_device import DEVICE
from drivers.errors import LinkError, LinkLost, LinkTimeout, ProtocolError

LINK = "127.0.0.1:502"
ERRORS: tuple[tuple[type[LinkError], str], ...] = (
    (LinkLost, "connection reset"),
    (LinkTimeout, "no answer within 2 s"),
    (ProtocolError, "the answer belongs to no request"),
)


def _drawn_error(rng: Generator) -> LinkError:
    kind, text = ERRORS[int(rng.integers(len(ERRORS)))]
    return kind(text, hint="check the cable", link=LINK, device=DEVICE)


def lost_link(scene: FaultScene, rng: Generator) -> None:
    """Lose the link to the controller until the morning. The heartbeat stops the axes."""
    scene.size = "until the morning"
    scene.note_stop()
    _cut(scene, None, _drawn_error(rng))


def interrupted_link(scene: FaultScene, rng: Generator) -> None:
    """Lose the link to the controller for some time. The heartbeat stops the axes."""
    lasts_s = duration_s(rng)
    scene.size = f"{lasts_s:.1f} s"
    _cut(scene, scene.clock.now() + lasts_s, _drawn_error(rng))


def _cut(scene: FaultScene, until_s: float | None, error: LinkError) -> None:
    scene.world.controller.fail("heartbeat of the agent lost")

    def fail(name: str) -> None:
        if name != "close" and (until_s is None or scene.clock.now() < until_s):
            raise _same(error)

    scene.machine.check(fail)


def lost_call(scene: FaultScene, rng: Generator) -> None:
    """Let the next call fail without an effect."""
    error = _drawn_error(rng)

    def fail(_: str) -> None:
        end()
        raise _same(error)

    end = scene.machine.check(fail)


def lost_answer(scene: FaultScene, rng: Generator) -> None:
    """Let the answer to the next command be lost after the command has had its effect."""
    error = _drawn_error(rng)

    def lose(real: Any, *values: Any, **named: Any) -> Any:
        end()
        real(*values, **named)
        raise _same(error)

    end = scene.machine.alter(**dict.fromkeys(COMMANDS, lose))


def _same(error: LinkError) -> LinkError:
    """Return a copy of the error, because errors collect the places that their callers know."""
    return type(error)(error.message, hint=error.hint, **error.where)
