"""Journaled observations keep the keys that earlier program versions wrote."""

from __future__ import annotations

import json

import numpy as np

from agent.execution.encoding import to_json
from agent.results.journal_entries import observations_from, observations_record
from twin.artefact.observations import Observations

KEYS = [
    "position",
    "ball",
    "tool",
    "axis_positions",
    "covariance",
    "temperature_c",
    "elevation_rad",
    "tool_offsets",
    "course",
    "azimuth_rad",
]


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


def test_observations_are_journaled_under_their_former_keys_and_read_back() -> None:
    record = json.loads(to_json(observations_record(observations())))
    assert list(record) == KEYS
    assert record["course"] == [[0.0], [0.1], [0.3]]
    restored = observations_from(record)
    for name, value in vars(observations()).items():
        np.testing.assert_array_equal(getattr(restored, name), value)
