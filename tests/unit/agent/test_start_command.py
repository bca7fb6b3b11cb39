"""Exit codes of `volcal start` without a run: a timer must distinguish "not now" from "needs attention"."""

from __future__ import annotations

import pytest

from agent.cli.service_commands.start import begun
from agent.errors import Busy, GateRefused, ResetMissing
from agent.service.client import Document
from drivers.errors import CommandRejected, LinkLost, PermissionMissing, VolcalError


class Answering:
    """A client whose service answers a start with an error."""

    def __init__(self, error: VolcalError) -> None:
        self._error = error

    def post(self, path: str, body: object = None) -> Document:
        assert path == "/api/start"
        raise self._error


@pytest.mark.parametrize("kind", [Busy, GateRefused, PermissionMissing])
def test_a_start_refused_for_now_has_an_exit_code_of_its_own(
    kind: type[VolcalError], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        begun(Answering(kind("not now", hint="later")), {})  # type: ignore[arg-type]
    assert ended.value.code == 6
    assert "not now" in capsys.readouterr().err


@pytest.mark.parametrize("kind", [LinkLost, CommandRejected, ResetMissing])
def test_every_other_error_keeps_its_exit_code(kind: type[VolcalError]) -> None:
    with pytest.raises(kind):
        begun(Answering(kind("gone")), {})  # type: ignore[arg-type]
