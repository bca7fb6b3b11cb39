"""Comparison of the steps that a run has carried out with the branches of its plan that the preflight walked.

The machine in the preflight has no errors. On the real machine, a few steps depend on measured values, and only those
may differ.

A run may have further steps: a ball that was found far from its expected place, or whose sphere fails a gate, is
measured again, or its doubtful touches are repeated; the probe check is continued if the touches scatter; the run waits
until the temperatures have settled.

Other steps may be added or left out: paths have as many corners as the found places of the balls require; the tip stays
on the surface after a touch, or is moved back; the move from the plane in front of a ball to the start of a touch is
left out if the start lies in that plane.

An artefact that is placed by hand is asked for again until it stands where it should, and is searched where it stands.

Positions that a night chooses while it runs are proved then, from where the machine stands (`ProvePlan`); they are not
part of a branch.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence

from agent.planning.branch_walk import Branch

FURTHER = re.compile(
    r"""
    /ball-\d+/(again/)?repeat-\d+/         # the ball is measured again
    | /clean-up/touch-\d+(/|$)             # doubtful touches are repeated
    | ^probe/.*/check/touch-\d+(/|$)       # further touches of the probe check
    | /settle-\d+/wait$                    # the temperatures have not settled
    """,
    re.VERBOSE,
)
"""Keys of steps that a run may have in addition to those that were walked."""

VARYING = re.compile(
    r"""
    /(via|away|out)-\d+$       # corners of a path
    | /touch-\d+/back$         # move off the surface after a touch
    | /off$                    # the same before the probe is withdrawn
    | /place-\d+/              # search for an artefact that a person has placed, and repeated requests to place it
    """,
    re.VERBOSE,
)
"""Keys of steps that a run may have or not have, whether they were walked or not."""


CHOSEN = (("night/fewer", "further/"), ("night/diagnosis-", "diagnosis/"))
"""Beginnings of the keys of steps that prove a plan during the run, and of the steps of that plan."""


def walked_branch(keys: Sequence[str], branches: Sequence[Branch]) -> Branch | str:
    """Return the first of `branches` that has the steps with the keys `keys`, in the same order, except for steps that
    depend on measured values.

    If there is none, return the key at which the run left all branches: the first one that no branch has there or, if
    the run ended too early, the one that should have followed.
    """
    best, left, chosen = -1, "", _chosen_in(keys)
    for branch in branches:
        walked = frozenset(branch.keys)
        taken, theirs = (
            [key for key in _lasting(some, walked) if not key.startswith(chosen)] for some in (keys, branch.keys)
        )
        if taken == theirs:
            return branch
        common = _common(taken, theirs)
        if common > best:
            best, left = common, (taken[common:] or theirs[common:])[0]
    return left


def _lasting(keys: Sequence[str], walked: Collection[str]) -> list[str]:
    """Return those of `keys` that must be the same in the run and in a branch with the keys `walked`."""
    return [key for key, former in zip(keys, ("", *keys), strict=False) if not _differs(key, former, walked)]


def _chosen_in(keys: Sequence[str]) -> tuple[str, ...]:
    """Return the beginnings of the keys of plans that the run with the steps `keys` has chosen and proved itself."""
    pairs = [pair for pair in CHOSEN if any(key.startswith(pair[0]) for key in keys)]
    return tuple(one for pair in pairs for one in pair)


def _differs(key: str, former: str, walked: Collection[str]) -> bool:
    """Return True if the step `key` after the step `former` may be missing on the other side."""
    if key not in walked and FURTHER.search(key):
        return True
    return VARYING.search(key) is not None or (key.endswith("/start") and former == f"{key[:-6]}/above")


def _common(one: Sequence[str], other: Sequence[str]) -> int:
    """Return the number of keys with which both begin."""
    pairs = enumerate(zip(one, other, strict=False))
    return next((number for number, (a, b) in pairs if a != b), min(len(one), len(other)))
