"""Pairing codes: six digits that a person reads at the controller PC and enters on a panel or a phone.

Six digits can be guessed, so a code is only good for a few minutes, for one use and for few wrong tries, and the tries
of all clients together are limited per minute. There is one code at a time: a wrong try therefore counts against it,
whoever made it.
"""

from __future__ import annotations

import secrets
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from threading import Lock
from typing import TypeVar

from agent.service.access.roles import Role
from drivers.errors import UserError
from twin.units import S_PER_MIN

Admitted = TypeVar("Admitted")
DIGITS = 6
MAX_WRONG_TRIES = 5
"""Number of wrong tries after which the code is void."""
MAX_TRIES_PER_MINUTE = 10
MAX_MINUTES = 60
"""Longest validity of a code."""


class WrongCode(UserError):
    """Error for a code that is wrong, used, void or too old. Which of them it is, is not told."""


class TooManyTries(UserError):
    """Error for a try that was not judged because there were too many within a minute. `wait_s` is the time in s after
    which the next try is judged."""

    def __init__(self, wait_s: float) -> None:
        super().__init__("there were too many tries to pair within a minute", hint="try again in a minute")
        self.wait_s = wait_s


@dataclass(frozen=True)
class Invitation:
    """Client that a code lets in: its role, and the name under which it will be known."""

    role: Role
    name: str


def six_digits() -> str:
    return f"{secrets.randbelow(10**DIGITS):0{DIGITS}d}"


@dataclass
class _OpenCode:
    code: str
    invitation: Invitation
    ends_s: float
    wrong: int = 0


@dataclass
class PairingCodes:
    """Open code, of which there is at most one. `now` is a monotonic clock in s, and `draw` makes a code. It is safe
    to use from any thread."""

    now: Callable[[], float]
    draw: Callable[[], str] = six_digits
    _lock: Lock = field(default_factory=Lock)
    _open: _OpenCode | None = None
    _tries: deque[float] = field(default_factory=deque)

    def open(self, invitation: Invitation, minutes: float) -> str:
        """Return a new code for `invitation`, which is good for `minutes`. A former code is void from now on."""
        with self._lock:
            self._open = _OpenCode(self.draw(), invitation, self.now() + S_PER_MIN * minutes)
            return self._open.code

    def use(self, code: str, admit: Callable[[Invitation], Admitted]) -> Admitted:
        """Return what `admit` makes of the invitation of `code`, which is void from then on. Raise TooManyTries,
        WrongCode or an error of `admit`, after which the code is as good as before."""
        with self._lock:
            now = self.now()
            self._count_try(now)
            found = self._open
            if found is not None and now >= found.ends_s:
                self._open = found = None
            # A code that cannot be one is compared all the same: the time of the answer tells nothing.
            right = secrets.compare_digest(code.encode(), (found.code if found else "none").encode())
            if found is None:
                raise _wrong()
            if right:
                admitted = admit(found.invitation)
                self._open = None
                return admitted
            found.wrong += 1
            if found.wrong >= MAX_WRONG_TRIES:
                self._open = None
            raise _wrong()

    def _count_try(self, now: float) -> None:
        while self._tries and now - self._tries[0] >= S_PER_MIN:
            self._tries.popleft()
        if len(self._tries) >= MAX_TRIES_PER_MINUTE:
            raise TooManyTries(self._tries[0] + S_PER_MIN - now)
        self._tries.append(now)


def _wrong() -> WrongCode:
    return WrongCode(
        "this code is wrong or no longer valid",
        hint=f"a code is good for one use, for some minutes and for {MAX_WRONG_TRIES} tries: make a new one with "
        "`volcal pair` on the controller PC",
    )
