"""Questions of `volcal init`, answered by options, by a person at a terminal or by proposals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import click

from agent.files import translated
from drivers.errors import InputError

Answer = TypeVar("Answer")


@dataclass(frozen=True)
class SetupQuestions:
    """Source of answers that no option gave: a person if `interactive`, else the proposals."""

    interactive: bool

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

        A person is asked again if `read` raises an error. Without a person, the answer is `proposal`. Raises
        InputError, which names `option`, if there is none.
        """
        if not self.interactive:
            if proposal is None:
                listed = f"; one of {', '.join(choices)}" if choices else ""
                raise InputError(f"{option} is needed: {question}{listed}", hint=f"state {option}", option=option)
            with translated(InputError, option=option):
                return read(proposal)
        kind = click.Choice(list(choices)) if choices else None
        while True:
            text = str(click.prompt(question, default=proposal, type=kind, err=True))
            try:
                with translated(InputError, option=option):
                    return read(text)
            except InputError as error:
                click.echo(f"{error}", err=True)
