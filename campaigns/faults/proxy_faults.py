"""Faults of a Modbus TCP link with real sockets, made by a proxy between the driver and the simulated controller."""

from __future__ import annotations

import random
import threading

from numpy.random import Generator

from campaigns.faults import tcp_proxy
from campaigns.faults.controller_faults import duration_s
from campaigns.faults.fault_scene import FaultScene
from campaigns.faults.tcp_proxy import Disturb, ModbusProxy

LONGEST_DELAY_S = 1.5
"""Longest delay in s of the wall clock, three times the timeout of the driver."""


def delayed_frames(scene: FaultScene, rng: Generator) -> None:
    """Delay some frames, shorter or longer than the timeout of the driver."""
    by_s, count = float(rng.uniform(0.01, LONGEST_DELAY_S)), int(rng.integers(1, 4))
    wait = threading.Event().wait
    _disturb(scene, rng, tcp_proxy.delayed(wait, by_s, count), f"{count} by {by_s:.2f} s")


def lost_frames(scene: FaultScene, rng: Generator) -> None:
    """Lose some frames."""
    count = int(rng.integers(1, 5))
    _disturb(scene, rng, tcp_proxy.lost(count), f"{count}")


def repeated_frames(scene: FaultScene, rng: Generator) -> None:
    """Deliver some frames twice."""
    count = int(rng.integers(1, 20))
    _disturb(scene, rng, tcp_proxy.repeated(count), f"{count}")


def reordered_frames(scene: FaultScene, rng: Generator) -> None:
    """Deliver a frame together with the next one, before or after it."""
    late_first = bool(rng.integers(2))
    _disturb(scene, rng, tcp_proxy.reordered(late_first=late_first), "late" if late_first else "after the next")


def garbled_frames(scene: FaultScene, rng: Generator) -> None:
    """Alter some frames."""
    count, seed = int(rng.integers(1, 4)), int(rng.integers(2**32))
    _disturb(scene, rng, tcp_proxy.garbled(random.Random(seed), count), f"{count}")  # noqa: S311  no secret


def cut_connection(scene: FaultScene, rng: Generator) -> None:
    """Cut the connection, and refuse new ones: not at all, for some time, or until the morning."""
    proxy, how = _proxy(scene), int(rng.integers(3))
    proxy.refusing = how > 0
    if how == 1:
        lasts_s = duration_s(rng)
        scene.clock.at(scene.clock.now() + lasts_s, proxy.repair)
    scene.size = ("opened again at once", "for some time", "until the morning")[how]
    if how == 2:
        scene.note_stop()
    proxy.cut()


def stuck_connection(scene: FaultScene, _: Generator) -> None:
    """Let nothing pass any more, with both ends connected."""
    scene.note_stop()
    _proxy(scene).stop_forwarding()


def _proxy(scene: FaultScene) -> ModbusProxy:
    assert scene.proxy is not None
    return scene.proxy


def _disturb(scene: FaultScene, rng: Generator, disturb: Disturb, size: str) -> None:
    proxy, upwards = _proxy(scene), bool(rng.integers(2))
    scene.size = f"{size}, {'requests' if upwards else 'answers'}"
    if upwards:
        proxy.to_server = disturb
    else:
        proxy.to_client = disturb
