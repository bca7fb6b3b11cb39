"""Misfit modes: unit size, and independence from the model."""

from __future__ import annotations

import numpy as np
import pytest
from measured_set import RANGES, TOOL, case_study

from twin.identification.misfit import misfit_modes
from twin.machine.forward_model import deviation_basis
from twin.machine.legendre import legendre_values, normalise_positions
from twin.machine.volumetric import align_rigidly, evaluation_grid, rms

CELLS = (30, 14, 14)

MODEL, _ = case_study(5)
MODES = misfit_modes(MODEL, (0.0, 250.0, 0.0))


def test_prior_rms_over_the_workspace_is_one() -> None:
    points = np.random.default_rng(0).uniform(0.0, 1.0, (4000, 3)) * [4000.0, 1300.0, 1500.0]
    modes = np.mean(np.sum(MODES.at(points) ** 2, axis=(1, 2)))
    assert modes + 3.0 * MODES.left_out.sum() == pytest.approx(1.0, abs=0.02)
    assert modes > 0.6


def test_the_model_cannot_imitate_a_mode() -> None:
    """After fitting model and rigid motion over the centres of many cells, a mode keeps its size."""
    half = [0.5 * (high - low) / count for (low, high), count in zip(RANGES, CELLS, strict=True)]
    x, y, z = ((low + h, high - h) for (low, high), h in zip(RANGES, half, strict=True))
    grid = evaluation_grid((x, y, z), CELLS)
    basis = deviation_basis(MODEL, grid, TOOL)
    columns = np.stack([align_rigidly(grid + TOOL, basis[:, :, k]).reshape(-1) for k in range(MODEL.size)], axis=1)
    used = np.linalg.svd(columns / np.linalg.norm(columns, axis=0).clip(1e-9), full_matrices=False)
    left = used[0][:, used[1] > 1e-9 * used[1][0]]
    modes = MODES.at(grid)
    for k in range(MODES.size):
        mode = align_rigidly(grid + TOOL, modes[:, :, k])
        rest = mode.reshape(-1) - left @ (left.T @ mode.reshape(-1))
        assert rms(rest.reshape(-1, 3)) > 0.75 * rms(mode)


def test_a_wave_above_the_order_of_the_model_is_in_the_modes() -> None:
    grid = evaluation_grid(RANGES, (33, 7, 7))
    wave = np.zeros((len(grid), 3))
    wave[:, 1] = legendre_values(normalise_positions(grid[:, 0], RANGES[0]), 6)[6]
    model = deviation_basis(MODEL, grid, TOOL).reshape(-1, MODEL.size)
    model /= np.linalg.norm(model, axis=0).clip(1e-9)

    def left_by(columns: np.ndarray) -> float:
        fitted = columns @ np.linalg.lstsq(columns, wave.reshape(-1), rcond=1e-10)[0]
        return rms(wave - fitted.reshape(-1, 3))

    assert left_by(model) > 0.8 * rms(wave)
    assert left_by(np.hstack((model, MODES.at(grid).reshape(-1, MODES.size)))) < 0.3 * rms(wave)
