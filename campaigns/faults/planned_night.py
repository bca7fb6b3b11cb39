"""Choice of everything that happens in a night: its faults with their instants and sizes, and its mornings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.random import Generator

from campaigns.faults.fault_kinds import COMPUTER, KILLED, KINDS

PUBLISHING = ("before/active-table", "publish/stage", "publish/read-back", "activate/activate", "activate/active-bank")
"""Keys of the steps that read, write or activate tables; they take no machine time, so that no drawn instant of time
meets them."""
PUBLISHING_SHARE = 0.3
RESTORING = ("restore/reset", "restore/activate", "restore/active-bank", "recover/withdraw", "recover/retreat")
"""Keys of steps at the end of a run that did not succeed."""
RETURNING = (
    "resume-1/compensation/active-bank",
    "resume-1/compensation/activate",
    "resume-1/here",
    "resume-1/orient",
    "resume-1/datum/approach",
    "resume-1/beside",
)
"""Keys of steps with which a resumed run returns to where it was."""
START_SHARE = 0.6
"""Share of the nights whose fault is there from the beginning, among the faults that a person makes before it."""
LINKS = ("TCP", "RTU", "CAN")
LINKED_EVERY = 12
"""One night in so many has a real link, of these in turn; it takes several times as long as the others."""
SECOND_SHARE = 0.35
"""Share of the nights with a second fault."""
RESUMED_SHARE = 0.75
"""Share of the nights whose unfinished run is resumed in the morning, if it can be."""

Morning = Literal["restart", "resume", "restart, then resume", "give up"]
"""Events of a morning: volcal is started again, which compares the controller with the journal, or its run is resumed
at once, or both, or it is given up."""


@dataclass(frozen=True)
class SecondFault:
    """Fault that begins after the first one: at the end of its run, or in the resumed run if `resumed` is True.

    It begins `delay_s` seconds of machine time after the first fault or after the beginning of the resumption or, if
    `key` is not empty, at the step with this key: before it, or if `after` is True after its effect.
    """

    kind: str
    resumed: bool
    delay_s: float
    key: str = ""
    after: bool = False


@dataclass(frozen=True)
class PlannedNight:
    """Faults and mornings of one night. The first fault has the kind `kind`. It begins at the fraction `fraction` of
    the machine time of an undisturbed night or, if `key` is not empty, at the step with this key: before it, or if
    `after` is True after its effect. `mornings` are those after the run, after its resumption, and so on. `seed` and
    `night` are the numbers from which everything is drawn."""

    seed: int
    night: int
    kind: str
    fraction: float
    key: str = ""
    after: bool = False
    second: SecondFault | None = None
    mornings: tuple[Morning, ...] = ("restart",)

    @property
    def link(self) -> str:
        """Kind of the real link of the night; empty if there is none."""
        return KINDS[self.kind].link

    @property
    def group(self) -> str:
        return COMPUTER if self.kind == KILLED else KINDS[self.kind].group

    def generator(self, fault: int) -> Generator:
        """Return the generator of the size of the fault with the number `fault`, from 1 on."""
        return np.random.default_rng([self.seed, self.night, (0, 1, 4)[fault]])


SEEN_BY_PROOF = PlannedNight(3, 557, "wrong bank", 0.59, mornings=("restart, then resume", "restart"))
"""The controller activates a third bank, reports the one asked for, and does so again when the former one is restored.
The proof measures that."""
SEEN_BY_NOBODY = PlannedNight(
    6,
    19087,
    "probe battery",
    1.0,
    "activate/active-bank",
    second=SecondFault("wrong bank", resumed=False, delay_s=0.0, key="restore/activate"),
    mornings=("give up",),
)
"""The restoration is reported wrongly, and nothing is measured after it."""
NAMED_IN_THE_MORNING = PlannedNight(3, 241, "wrong bank", 1.0, "publish/read-back")
"""The controller activates a third bank and says so."""
JUMPED_BEFORE_PROOF = PlannedNight(
    77, 116, "thermometer wrong", 1.0, "publish/read-back", mornings=("resume", "restart")
)
"""All thermometers show -127 °C from the first reading of the proof on."""
READ_ONLY_AS_IT_IS_RESUMED = PlannedNight(
    61,
    1889,
    "read-only",
    0.675,
    second=SecondFault("read-only", resumed=True, delay_s=0.027),
    mornings=("resume", "resume", "restart"),
)
"""The journal can be written again only for the second resumption."""
READ_ONLY_BEFORE_THE_END = PlannedNight(
    61,
    3792,
    "disk full",
    0.428,
    second=SecondFault("read-only", resumed=True, delay_s=0.0, key="activate/active-bank", after=True),
    mornings=("resume", "restart, then resume", "restart"),
)
"""A resumed run faults, since its journal can be read only; it says so although nothing of its end can be recorded."""
STRUCK_A_DISPLACED_BALL = PlannedNight(61, 2818, "ball exchanged", 0.596, mornings=("resume", "resume", "restart"))
"""A ball is displaced by 3.5 mm during the run and struck at rapid traverse; the resumed run must not do so again."""
KNOWN_DURATION_S = 693.0
"""Machine time in s over which the instants of the known nights were drawn."""
KNOWN_NIGHTS = (
    SEEN_BY_PROOF,
    SEEN_BY_NOBODY,
    NAMED_IN_THE_MORNING,
    JUMPED_BEFORE_PROOF,
    READ_ONLY_AS_IT_IS_RESUMED,
    READ_ONLY_BEFORE_THE_END,
    STRUCK_A_DISPLACED_BALL,
)
"""Nights that have once found a defect, as they were drawn then: with a new kind of fault, other nights are drawn."""


def plan_night(seed: int, night: int) -> PlannedNight:
    """Return what happens in the night number `night` of the campaign with this seed.

    All kinds of the first fault occur equally often: each of successive nights has another one, in an order drawn for
    each round.
    """
    turn, left = divmod(night, LINKED_EVERY)
    link = LINKS[turn % len(LINKS)] if left == LINKED_EVERY - 1 else ""
    names = [name for name, kind in KINDS.items() if kind.link == link]
    count = turn // len(LINKS) if link else night - turn
    entropy = [seed, count // len(names), 2, *([LINKS.index(link) + 1] if link else [])]
    order = np.random.default_rng(entropy).permutation(len(names))
    kind = names[order[count % len(names)]]
    second, mornings = _later(np.random.default_rng([seed, night, 3]), link)
    rng = np.random.default_rng([seed, night, 0])
    if KINDS[kind].of_evening and rng.random() < START_SHARE:
        return PlannedNight(seed, night, kind, 0.0, second=second, mornings=mornings)
    if rng.random() < PUBLISHING_SHARE and link != "CAN":  # the tables are not on the link to the mount
        key, after = str(rng.choice(PUBLISHING)), bool(rng.integers(2))
        return PlannedNight(seed, night, kind, 1.0, key, after, second, mornings)
    return PlannedNight(seed, night, kind, float(rng.random()), second=second, mornings=mornings)


def _later(rng: Generator, link: str) -> tuple[SecondFault | None, tuple[Morning, ...]]:
    """Return the second fault of a night, or None, and its mornings.

    Both faults of a night with a real link are on it.
    """
    share = float(rng.random())
    mornings: list[Morning] = ["give up" if share > 0.9 else "restart"]
    if share < RESUMED_SHARE:
        mornings = ["resume" if rng.integers(2) else "restart, then resume", *mornings]
        if rng.integers(2):
            mornings = ["resume", *mornings]
    if rng.random() >= SECOND_SHARE:
        return None, tuple(mornings)
    resumed = len(mornings) > 1 and bool(rng.integers(2))
    kinds = [name for name, kind in KINDS.items() if kind.link == link]
    kind, at_step, after = str(rng.choice(kinds)), bool(rng.integers(2)), bool(rng.integers(2))
    if at_step:
        keys = (*RETURNING, *PUBLISHING) if resumed else RESTORING
        return SecondFault(kind, resumed, 0.0, str(rng.choice(keys)), after), tuple(mornings)
    longest_s = 3000.0 if resumed else 30.0
    delay_s = float(np.exp(rng.uniform(np.log(0.01), np.log(longest_s))))
    return SecondFault(kind, resumed, delay_s), tuple(mornings)
