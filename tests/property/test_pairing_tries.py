"""Nobody guesses a pairing code: every sequence of codes, tries and waiting keeps within the bounds of the tries."""

from __future__ import annotations

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from agent.service.access.pairing_codes import (
    MAX_TRIES_PER_MINUTE,
    MAX_WRONG_TRIES,
    Invitation,
    PairingCodes,
    TooManyTries,
    WrongCode,
)
from drivers.clock import VirtualClock
from twin.units import S_PER_MIN


def as_it_is(invitation: Invitation) -> Invitation:
    return invitation


class PairingTries(RuleBasedStateMachine):
    """Model: the time of each judged try, and of each code its end, its wrong tries and whether it was used."""

    def __init__(self) -> None:
        super().__init__()
        self.clock = VirtualClock()
        self.opened: list[str] = []
        self.pairing = PairingCodes(self.clock.now, self._draw)
        self.judged: list[float] = []
        self.ends = 0.0
        self.wrong = 0
        self.used = False

    def _draw(self) -> str:
        self.opened.append(f"{len(self.opened):06d}")
        return self.opened[-1]

    @rule(minutes=st.sampled_from([1.0, 5.0]))
    def open_code(self, minutes: float) -> None:
        number = len(self.opened)
        assert self.pairing.open(Invitation("operator", str(number)), minutes) == self.opened[-1]
        self.ends, self.wrong, self.used = self.clock.now() + S_PER_MIN * minutes, 0, False

    @rule(seconds=st.sampled_from([1.0, 10.0, 30.0, 59.0, 60.0, 300.0]))
    def wait(self, seconds: float) -> None:
        self.clock.sleep(seconds)

    @rule()
    def use_present_code(self) -> None:
        self._use(0)

    @rule(back=st.integers(1, 3), times=st.sampled_from([1, MAX_WRONG_TRIES - 1, MAX_WRONG_TRIES]))
    def use_another(self, back: int, times: int) -> None:
        """Try a former code, or one that never was."""
        for _ in range(times):
            self._use(back)

    def _use(self, back: int) -> None:
        code = self.opened[-1 - back] if back < len(self.opened) else "999999"
        now = self.clock.now()
        good = back == 0 and bool(self.opened) and not self.used and self.wrong < MAX_WRONG_TRIES and now < self.ends
        recent = sum(now - at < S_PER_MIN for at in self.judged)
        try:
            invitation = self.pairing.use(code, as_it_is)
        except TooManyTries as error:
            assert recent >= MAX_TRIES_PER_MINUTE
            assert 0.0 < error.wait_s <= S_PER_MIN
            return
        except WrongCode:
            assert not good
            self.wrong += 1
        else:
            assert good
            assert invitation.name == str(len(self.opened) - 1)
            self.used = True
        assert recent < MAX_TRIES_PER_MINUTE
        self.judged.append(now)

    @invariant()
    def few_tries_in_any_minute(self) -> None:
        most = MAX_TRIES_PER_MINUTE
        assert all(later - sooner >= S_PER_MIN for sooner, later in zip(self.judged, self.judged[most:], strict=False))


TestPairingTries = PairingTries.TestCase
TestPairingTries.settings = settings(max_examples=200, stateful_step_count=40, deadline=None)
