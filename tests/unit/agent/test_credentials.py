"""Files of secrets, and who may get at them."""

from __future__ import annotations

from pathlib import Path

import pytest

from agent.settings.credentials import handed_over, open_mode


def test_what_systemd_hands_over_is_found_by_its_name(tmp_path: Path) -> None:
    (tmp_path / "token").write_text("secret")
    assert handed_over("token", {"CREDENTIALS_DIRECTORY": str(tmp_path)}) == tmp_path / "token"
    assert handed_over("panel-code", {"CREDENTIALS_DIRECTORY": str(tmp_path)}) is None
    assert handed_over("token", {}) is None


@pytest.mark.parametrize(
    ("mode", "elsewhere", "credential"),
    [
        (0o400, None, None),
        (0o600, None, None),
        (0o440, 0o440, None),  # the mask of an access control list, as systemd leaves it
        (0o460, 0o460, 0o460),
        (0o444, 0o444, 0o444),
        (0o604, 0o604, 0o604),
    ],
)
def test_group_bits_are_a_mask_only_where_systemd_keeps_the_file(
    tmp_path: Path, mode: int, elsewhere: int | None, credential: int | None
) -> None:
    path = tmp_path / "token"
    path.write_text("secret")
    path.chmod(mode)
    assert open_mode(path, {}) == elsewhere
    assert open_mode(path, {"CREDENTIALS_DIRECTORY": str(tmp_path)}) == credential
    assert open_mode(path, {"CREDENTIALS_DIRECTORY": str(tmp_path.parent)}) == elsewhere
