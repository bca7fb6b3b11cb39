"""Wrong touches that the check of a position finds, and its false alarms, for machines of the independent generator;
compared with the limits of a ball that is touched five times.

    python -m campaigns.touch_check --machines 20 --worse 1

A touch is wrong by a given distance: a false trip, a particle, a loose ball. The last line is one JSON object.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from agent.planning.procedure_rules import probing_of
from agent.probing.ball import first_failed_gate
from agent.settings.schema import ProcedureSettings
from campaigns.foreign.artefact import S3, measure, tilted_bar
from campaigns.foreign.machine import foreign_machine
from campaigns.foreign.score import family_of
from twin.artefact.observations import Observations
from twin.artefact.sphere_fit import fit_sphere
from twin.artefact.touch_pattern import approach_directions
from twin.collision.probe_frame import ProbeFrame
from twin.design.measurement_setup import AS_STATED
from twin.identification.checks.touch_consistency import TouchConsistency

WRONG_UM = (5.0, 8.0, 10.0, 15.0, 20.0, 30.0, 50.0)
STYLUS = np.array([0.0, 1.0, 0.0])
TIP_RADIUS_MM, NOISE_MM = 2.0, 1e-3
FALSE_ALARM = ProcedureSettings().position_false_alarm


@dataclass
class Counts:
    """Number of positions, of those in which a wrong touch was found without one, and of other balls that were named
    with one.

    `found` maps the size of a wrong touch in µm to the number of positions in which its ball was named."""

    positions: int = 0
    alarms: int = 0
    others: int = 0

    def __post_init__(self) -> None:
        self.found = dict.fromkeys(WRONG_UM, 0)


def positions_of(seed: int, worse: float) -> Iterator[tuple[Observations, TouchConsistency]]:
    """Yield the positions of S3 of one machine, each touched three times a ball, with the check of their touches."""
    rng = np.random.default_rng(seed)
    machine, bar = foreign_machine(rng, worse), tilted_bar(rng)
    # Three touches at right angles to each other give every coordinate the noise of a touch, as `measure` does.
    seen = measure(machine, bar, S3, rng).seen
    check = TouchConsistency(family_of(5), bar.artefact, AS_STATED, approach_directions(3, STYLUS), FALSE_ALARM)
    for number in range(int(seen.position.max()) + 1):
        one = seen.select(np.flatnonzero(seen.position == number))
        yield replace(one, position=np.zeros(one.size, dtype=int)), check


def count(seeds: Sequence[int], worse: float) -> Counts:
    """Return what the check finds in the positions of the machines `seeds`, with and without one wrong touch."""
    counts, rng = Counts(), np.random.default_rng(0)
    for seed in seeds:
        for seen, check in positions_of(seed, worse):
            counts.positions += 1
            counts.alarms += bool(check.inconsistent(seen))
            for wrong_um in WRONG_UM:
                ball, touch = int(rng.integers(seen.size)), int(rng.integers(len(check.directions)))
                moved = seen.axis_positions.copy()
                moved[ball] += 1e-3 * wrong_um * check.directions[touch]
                named = [one.ball for one in check.inconsistent(replace(seen, axis_positions=moved))]
                counts.found[wrong_um] += ball in named
                counts.others += len([one for one in named if one != ball])
    return counts


def five_touch_power(wrong_um: float, trials: int = 400) -> float:
    """Return the fraction of wrong touches that the limits of a ball with five touches find."""
    rng = np.random.default_rng(1)
    probing = probing_of(ProcedureSettings(), TIP_RADIUS_MM, tilted_bar(rng).artefact, ProbeFrame.of(STYLUS))
    directions = probing.directions
    found = 0
    for _ in range(trials):
        off = rng.normal(0.0, NOISE_MM, len(directions))
        off[rng.integers(len(directions))] += 1e-3 * wrong_um
        points = -directions * (probing.contact_mm + off)[:, None]
        found += first_failed_gate(fit_sphere(points, NOISE_MM), probing) is not None
    return found / trials


def main() -> None:
    parser = argparse.ArgumentParser(description="Wrong touches found in positions touched three times a ball.")
    parser.add_argument("--machines", type=int, default=20)
    parser.add_argument("--worse", type=float, default=1.0, help="errors of the machines as multiples of their family")
    parser.add_argument("--seed", type=int, default=100)
    given = parser.parse_args()
    counts = count(range(given.seed, given.seed + given.machines), given.worse)
    share = {f"{wrong:g}": round(found / counts.positions, 3) for wrong, found in counts.found.items()}
    five = {f"{wrong:g}": five_touch_power(wrong) for wrong in WRONG_UM}
    summary = {
        "positions": counts.positions,
        "false_alarms": counts.alarms,
        "found": share,
        "other_balls": counts.others,
        "five_touches": five,
    }
    print(json.dumps(summary))


if __name__ == "__main__":
    main()
