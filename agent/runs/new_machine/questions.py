"""Questions about a new machine, whoever is asked them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol, TypeVar

from agent.files import translated
from drivers.errors import InputError

Answer = TypeVar("Answer")


class SetupQuestions(Protocol):
    """Source of the answers that no option gave."""

    def ask(
        self,
        option: str,
        question: str,
        read: Callable[[str], Answer],
        *,
        proposal: str | None = None,
        choices: Sequence[str] = (),
    ) -> Answer:
        """Return the answer to `question`, converted by `read`.

        Raises InputError, which names `option`, if there is neither an answer nor a `proposal`.
        """
        ...


class ProposalsOnly:
    """Answers without asking anyone: each answer is the proposal."""

    def ask(
        self,
        option: str,
        question: str,
        read: Callable[[str], Answer],
        *,
        proposal: str | None = None,
        choices: Sequence[str] = (),
    ) -> Answer:
        if proposal is None:
            listed = f"; one of {', '.join(choices)}" if choices else ""
            raise InputError(f"{option} is needed: {question}{listed}", hint=f"state {option}", option=option)
        with translated(InputError, option=option):
            return read(proposal)
