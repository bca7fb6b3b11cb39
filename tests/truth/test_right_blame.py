"""What is wrong is named: a machine far outside its family, and touch noise that was stated too small."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from agent.errors import GateRefused
from agent.results.gates.estimate_gates import estimate_gates
from agent.results.gates.gate_rules import FIT
from agent.results.gates.required_gates import names_of_failed, require_passed
from agent.settings.schema import GateSettings
from campaigns.foreign.artefact import NOISE_MM, S3, measure, tilted_bar
from campaigns.foreign.machine import foreign_machine
from campaigns.foreign.score import family_of
from twin.identification import identify

FAMILY = family_of(8)
LIMITS = GateSettings()


@pytest.mark.parametrize("seed", range(4))
def test_a_machine_thirty_times_its_family_is_not_blamed_on_a_change_or_a_moved_artefact(seed: int) -> None:
    rng = np.random.default_rng([seed, 31])
    machine, bar = foreign_machine(rng, worse=30.0), tilted_bar(rng)
    seen = measure(machine, bar, S3, rng).seen
    gates = estimate_gates(identify(FAMILY.model, seen, bar.artefact, FAMILY), LIMITS)
    assert names_of_failed(gates) == (FIT,)
    with pytest.raises(GateRefused, match=r"the errors of the machine are \d\d times those of its family") as refused:
        require_passed(gates)
    assert refused.value.hint is not None
    assert "model.family" in refused.value.hint


@pytest.mark.parametrize("seed", range(2))
def test_noise_stated_twice_too_small_is_named(seed: int) -> None:
    rng = np.random.default_rng([seed, 32])
    machine, bar = foreign_machine(rng), tilted_bar(rng)
    seen = measure(machine, bar, S3, rng).seen
    more = rng.normal(0.0, NOISE_MM * 3.0**0.5, seen.axis_positions.shape)
    noisy = replace(seen, axis_positions=seen.axis_positions + more)
    gates = estimate_gates(identify(FAMILY.model, noisy, bar.artefact, FAMILY), LIMITS)
    assert names_of_failed(gates) == (FIT,)
    with pytest.raises(GateRefused, match=r"scatter (1\.9|2\.0|2\.1) times as much as stated") as refused:
        require_passed(gates)
    assert refused.value.hint is not None
    assert refused.value.hint.startswith("state how well the probe repeats")
    assert "more positions do not help" in refused.value.hint
