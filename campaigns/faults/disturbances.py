"""Disturbances of the frames of a link: delay, loss, repetition, another order, alteration."""

from __future__ import annotations

import random
from collections.abc import Callable

Disturb = Callable[[bytes], list[bytes]]
"""Function that returns the data to be sent instead of one frame, in order; it may wait."""


def unchanged(frame: bytes) -> list[bytes]:
    """Return the frame as it is."""
    return [frame]


def delayed(wait: Callable[[float], object], by_s: float, count: int) -> Disturb:
    """Return a function that delays the next `count` frames by `by_s` seconds; `wait` is the function that waits."""

    def disturb(frame: bytes) -> list[bytes]:
        nonlocal count
        count -= 1
        if count >= 0:
            wait(by_s)
        return [frame]

    return disturb


def lost(count: int) -> Disturb:
    """Return a function that drops the next `count` frames."""

    def disturb(frame: bytes) -> list[bytes]:
        nonlocal count
        count -= 1
        return [] if count >= 0 else [frame]

    return disturb


def repeated(count: int) -> Disturb:
    """Return a function that sends each of the next `count` frames twice."""

    def disturb(frame: bytes) -> list[bytes]:
        nonlocal count
        count -= 1
        return [frame, frame] if count >= 0 else [frame]

    return disturb


def reordered(*, late_first: bool) -> Disturb:
    """Return a function that holds the next frame back until the one after it: it is sent before that one, as a late
    answer, or after it.
    """
    held: list[bytes] = []
    done = False

    def disturb(frame: bytes) -> list[bytes]:
        nonlocal done
        if done:
            return [frame]
        if not held:
            held.append(frame)
            return []
        done = True
        return [held[0], frame] if late_first else [frame, held[0]]

    return disturb


def garbled(rng: random.Random, count: int) -> Disturb:
    """Return a function that alters the next `count` frames: a byte is changed, a byte is lost, noise comes before."""

    def disturb(frame: bytes) -> list[bytes]:
        nonlocal count
        count -= 1
        if count < 0:
            return [frame]
        at, how = rng.randrange(len(frame)), rng.randrange(3)
        if how == 0:
            return [frame[:at] + bytes([frame[at] ^ rng.randrange(1, 256)]) + frame[at + 1 :]]
        if how == 1:
            return [frame[:at] + frame[at + 1 :]]
        return [rng.randbytes(at + 1), frame]

    return disturb
