"""Faults of a real link, made by a proxy between the driver and the simulated device."""

from __future__ import annotations

import random
import threading
from collections.abc import Callable

from numpy.random import Generator

from campaigns.faults import disturbances
from campaigns.faults.controller_faults import duration_s
from campaigns.faults.disturbances import Disturb
from campaigns.faults.fault_scene import FaultScene
from campaigns.faults.link_proxy import LinkProxy

LONGEST_DELAY_S = 1.5
"""Longest delay in s of the wall clock, several times the timeout of each driver."""


def delayed_frames(scene: FaultScene, rng: Generator) -> None:
    """Delay some frames, shorter or longer than the timeout of the driver."""
    by_s, count = float(rng.uniform(0.01, LONGEST_DELAY_S)), int(rng.integers(1, 4))
    wait = threading.Event().wait
    _disturb(scene, rng, disturbances.delayed(wait, by_s, count), f"{count} by {by_s:.2f} s")


def lost_frames(scene: FaultScene, rng: Generator) -> None:
    """Lose some frames."""
    count = int(rng.integers(1, 5))
    _disturb(scene, rng, disturbances.lost(count), f"{count}")


def repeated_frames(scene: FaultScene, rng: Generator) -> None:
    """Deliver some frames twice."""
    count = int(rng.integers(1, 20))
    _disturb(scene, rng, disturbances.repeated(count), f"{count}")


def reordered_frames(scene: FaultScene, rng: Generator) -> None:
    """Deliver a frame together with the next one, before or after it."""
    late_first = bool(rng.integers(2))
    _disturb(scene, rng, disturbances.reordered(late_first=late_first), "late" if late_first else "after the next")


def garbled_frames(scene: FaultScene, rng: Generator) -> None:
    """Alter some frames."""
    count, seed = int(rng.integers(1, 4)), int(rng.integers(2**32))
    _disturb(scene, rng, disturbances.garbled(random.Random(seed), count), f"{count}")  # noqa: S311  no secret


def cut_connection(scene: FaultScene, rng: Generator) -> None:
    """Cut the connection, and refuse new ones: not at all, for some time, or until the morning."""
    proxy, how = _proxy(scene), int(rng.integers(3))
    proxy.refusing = how > 0
    if how == 1:
        lasts_s = duration_s(rng)
        scene.clock.at(scene.clock.now() + lasts_s, proxy.repair)
    scene.size = ("opened again at once", "for some time", "until the morning")[how]
    if how == 2 and scene.axes_linked:
        scene.note_stop()
    proxy.cut()


def stuck_connection(scene: FaultScene, _: Generator) -> None:
    """Let nothing pass any more, with both ends connected."""
    if scene.axes_linked:
        scene.note_stop()
    _proxy(scene).stop_forwarding()


FAULTS: dict[str, Callable[[FaultScene, Generator], None]] = {
    "delayed": delayed_frames,
    "lost": lost_frames,
    "repeated": repeated_frames,
    "reordered": reordered_frames,
    "garbled": garbled_frames,
    "cut": cut_connection,
    "stuck": stuck_connection,
}


def _proxy(scene: FaultScene) -> LinkProxy:
    assert scene.proxy is not None
    return scene.proxy


def _disturb(scene: FaultScene, rng: Generator, disturb: Disturb, size: str) -> None:
    proxy, upwards = _proxy(scene), bool(rng.integers(2))
    scene.size = f"{size}, {'to the device' if upwards else 'from the device'}"
    if upwards:
        proxy.to_server = disturb
    else:
        proxy.to_client = disturb
