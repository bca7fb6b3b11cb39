"""Euler-Bernoulli beam of many elements, solved as a system of linear equations."""

from __future__ import annotations

import numpy as np

Array = np.ndarray


def deflected_beam(
    ends: str,
    length_mm: float,
    at_mm: float,
    force_n: float,
    moment_n_mm: float,
    bending_n_mm2: float,
    elements: int = 24,
) -> tuple[float, float]:
    """Return deflection (mm) and slope (rad) of a beam at the distance `at_mm` from its first end.

    A force across the beam and a moment in the direction of its slope act there. `ends` is "cantilever" (with a free
    second end), "supported" or "clamped".
    """
    before = max(1, min(elements - 1, round(elements * at_mm / length_mm)))
    nodes = np.unique(
        np.concatenate((np.linspace(0.0, at_mm, before + 1), np.linspace(at_mm, length_mm, elements - before + 1)))
    )
    stiffness = np.zeros((2 * len(nodes),) * 2)
    for k, h in enumerate(np.diff(nodes)):
        rows = slice(2 * k, 2 * k + 4)
        stiffness[rows, rows] += (
            bending_n_mm2
            / h**3
            * np.array(
                [
                    [12.0, 6.0 * h, -12.0, 6.0 * h],
                    [6.0 * h, 4.0 * h * h, -6.0 * h, 2.0 * h * h],
                    [-12.0, -6.0 * h, 12.0, -6.0 * h],
                    [6.0 * h, 2.0 * h * h, -6.0 * h, 4.0 * h * h],
                ]
            )
        )
    last = 2 * len(nodes) - 2
    fixed = {"cantilever": (0, 1), "supported": (0, last), "clamped": (0, 1, last, last + 1)}[ends]
    free = np.setdiff1d(np.arange(2 * len(nodes)), fixed)
    place = 2 * int(np.argmin(np.abs(nodes - at_mm)))
    load = np.zeros(2 * len(nodes))
    load[place], load[place + 1] = force_n, moment_n_mm
    moved = np.zeros(2 * len(nodes))
    moved[free] = np.linalg.solve(stiffness[np.ix_(free, free)], load[free])
    return float(moved[place]), float(moved[place + 1])
