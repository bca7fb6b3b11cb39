"""Noise that depends only on a seed, the name of an independent sequence of numbers (stream) and a counter, never on
the order of the calls.
"""

from __future__ import annotations

from zlib import crc32

import numpy as np

_BLOCK = 1024
BY_STEP = 2**40
"""First counter value whose numbers are drawn individually. From here on the values are step tags, which come in no
particular order, so drawing in blocks would not save time."""


class NoiseSource:
    """Source of standard normal random numbers, three for each value of a counter."""

    def __init__(self, seed: int, stream: str) -> None:
        self._key = (seed, crc32(stream.encode()))
        self._blocks: dict[int, list[list[float]]] = {}

    def normal(self, counter: int) -> list[float]:
        """Return the three independent standard normal numbers that belong to `counter`."""
        if counter >= BY_STEP:
            x, y, z = np.random.default_rng([*self._key, counter]).standard_normal(3).tolist()
            return [x, y, z]
        block, place = divmod(counter, _BLOCK)
        if block not in self._blocks:
            rng = np.random.default_rng([*self._key, block])
            # only the latest block is kept, because counters rise
            self._blocks = {block: rng.standard_normal((_BLOCK, 3)).tolist()}
        return self._blocks[block][place]


def generator(seed: int, stream: str) -> np.random.Generator:
    """Return a random generator for values that are drawn only once. Each name `stream` selects an independent sequence
    of numbers.
    """
    return np.random.default_rng([seed, crc32(stream.encode())])
