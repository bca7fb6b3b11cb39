"""A cross-check that fails does not take the result of the run with it."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from agent.cli.run_commands import cross_check
from drivers.errors import LinkError


def test_a_cross_check_that_fails_is_reported_after_the_result(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def lost(*_: object) -> object:
        raise LinkError("the simulator does not answer", link="control")

    monkeypatch.setattr(cross_check, "predict_acceptance", lost)
    outcome = cast(Any, SimpleNamespace(estimation=object(), run_id="run", proof=None))
    settings = cast(Any, SimpleNamespace(state_directory=Path("state")))
    found = cross_check.attempt(outcome, settings, cast(Any, None), in_controller=True)
    assert found.as_json() == {"cross_check": None, "cross_check_error": str(found.error)}
    found.show()
    assert "no cross-check: " in capsys.readouterr().out
    with pytest.raises(SystemExit) as ended:
        found.conclude()
    assert ended.value.code == LinkError.exit_code
    assert "the simulator does not answer" in capsys.readouterr().err


def test_a_run_without_estimate_is_not_cross_checked() -> None:
    outcome = cast(Any, SimpleNamespace(estimation=None))
    found = cross_check.attempt(outcome, cast(Any, None), cast(Any, None), in_controller=True)
    assert found.as_json() == {"cross_check": None}
    found.conclude()
