"""Folder of the release files: a former release is replaced, anything else is left alone."""

from __future__ import annotations

from pathlib import Path

import pytest

from release.errors import ReleaseRefused
from release.folder import replace_release, require_replaceable
from release.source import commit_time

FORMER = (
    "volcal-0.0.9-py3-none-any.whl",
    "volcal_0.0.9-1_amd64.deb",
    "constraints.txt",
    "SHA256SUMS",
    "SHA256SUMS.sig",
)


def filled(folder: Path, *names: str) -> Path:
    folder.mkdir(parents=True)
    for name in names:
        (folder / name).write_text(name)
    return folder


def names_in(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("out", ["checkout", ".", "checkout/../checkout", "link"])
def test_a_folder_that_contains_the_checkout_is_refused(out: str, tmp_path: Path) -> None:
    root = filled(tmp_path / "checkout")
    (tmp_path / "link").symlink_to(root)
    with pytest.raises(ReleaseRefused, match="contains the checkout"):
        require_replaceable(tmp_path / out, root)


def test_a_folder_with_other_files_is_refused_and_unchanged(tmp_path: Path) -> None:
    out = filled(tmp_path / "out", *FORMER, "thesis.tex")
    with pytest.raises(ReleaseRefused, match=r"thesis\.tex is no file of a release"):
        require_replaceable(out, tmp_path / "checkout")
    assert names_in(out) == sorted([*FORMER, "thesis.tex"])


def test_a_folder_of_folders_is_refused(tmp_path: Path) -> None:
    filled(tmp_path / "out" / "volcal-0.0.9.whl", *FORMER)
    with pytest.raises(ReleaseRefused, match="is no file of a release"):
        require_replaceable(tmp_path / "out", tmp_path / "checkout")


def test_a_file_and_files_without_sums_are_refused(tmp_path: Path) -> None:
    out = filled(tmp_path / "out", "constraints.txt")
    with pytest.raises(ReleaseRefused, match="contains no SHA256SUMS"):
        require_replaceable(out, tmp_path / "checkout")
    with pytest.raises(ReleaseRefused, match="is not a folder"):
        require_replaceable(out / "constraints.txt", tmp_path / "checkout")


def test_a_former_release_is_replaced_and_an_empty_folder_is_filled(tmp_path: Path) -> None:
    new = ["SHA256SUMS", "SHA256SUMS.sig", "volcal-0.1.0-py3-none-any.whl"]
    made = filled(tmp_path / "made", *new)
    former, empty = filled(tmp_path / "former", *FORMER), filled(tmp_path / "empty")
    for out in (former, empty, tmp_path / "missing" / "release"):
        require_replaceable(out, tmp_path / "checkout")
        replace_release(out, made)
        assert names_in(out) == new


@pytest.mark.parametrize("given", ["²", "٣", "-1", "1.5", " "])
def test_a_time_that_is_no_number_of_seconds_is_refused(given: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", given)
    with pytest.raises(ReleaseRefused, match="must be a number of seconds"):
        commit_time(Path(__file__).parent)


def test_an_empty_time_is_not_set(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "12")
    assert commit_time(Path(__file__).parent) == 12
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "")
    assert commit_time(Path(__file__).parent) > 12
