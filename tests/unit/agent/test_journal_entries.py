"""Observations in the journal."""

from __future__ import annotations

import json

import numpy as np

from agent.execution.encoding import to_json
from twin.artefact.observations import Observations


def observations() -> Observations:
    return Observations(
        position=np.zeros(3, dtype=np.int64),
        ball=np.arange(3),
        tool=np.zeros(3, dtype=np.int64),
        axis_positions=np.array([[0.0, 0.0, 0.0], [100.0, 0.0, 0.0], [200.0, 1.0, 0.0]]),
        covariance=np.tile(1e-6 * np.eye(3), (3, 1, 1)),
        temperature_c=np.full(3, 20.5),
        elevation_rad=np.zeros(3),
        tool_offsets=np.array([[0.0, 250.0, 0.0]]),
        thermal_regressors=np.array([[0.0], [0.1], [0.3]]),
    )


def test_observations_are_journaled_and_read_back() -> None:
    restored = Observations(**json.loads(to_json(vars(observations()))))
    for name, value in vars(observations()).items():
        np.testing.assert_array_equal(getattr(restored, name), value)
