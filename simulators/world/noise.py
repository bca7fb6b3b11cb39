"""Noise that depends on a seed, a stream's name and a counter only, never on the order of asking."""

from __future__ import annotations

from zlib import crc32

import numpy as np

_BLOCK = 1024
BY_STEP = 2**40
"""Counters from here on are drawn one by one: tags of steps, which come in no order."""


class NoiseSource:
    """Standard normal numbers, three per counter value."""

    def __init__(self, seed: int, stream: str) -> None:
        self._key = (seed, crc32(stream.encode()))
        self._blocks: dict[int, list[list[float]]] = {}

    def normal(self, counter: int) -> list[float]:
        """Three independent standard normal numbers of `counter`."""
        if counter >= BY_STEP:
            x, y, z = np.random.default_rng([*self._key, counter]).standard_normal(3).tolist()
            return [x, y, z]
        block, place = divmod(counter, _BLOCK)
        if block not in self._blocks:
            rng = np.random.default_rng([*self._key, block])
            self._blocks = {block: rng.standard_normal((_BLOCK, 3)).tolist()}
        return self._blocks[block][place]


def generator(seed: int, stream: str) -> np.random.Generator:
    """A generator of its own for everything that is drawn once."""
    return np.random.default_rng([seed, crc32(stream.encode())])
