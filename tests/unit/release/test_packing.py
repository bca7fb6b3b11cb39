"""What is packed depends on the commit alone: not on other files in the checkout, the umask, times or the order on the
disk."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterable
from pathlib import Path

import pytest

from release.deb import pack
from release.errors import ReleaseRefused
from release.source import commit_time, export_tracked, git, require_clean

TIME = 1_700_000_000
CONTROL = (
    "Package: volcal\nVersion: 1\nArchitecture: all\nMaintainer: nobody <nobody@localhost>\nDescription: a trial\n"
)
FILES = {"usr/bin/volcal": (0o755, "#!/bin/sh\n"), "usr/share/b": (0o644, "b"), "usr/share/a": (0o644, "a" * 9000)}


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    root = tmp_path / "checkout"
    (root / "agent").mkdir(parents=True)
    (root / "config").mkdir()
    (root / "agent" / "main.py").write_text("print()\n")
    (root / "agent" / "main.py").chmod(0o600)
    (root / "agent" / "tool").write_text("#!/bin/sh\n")
    (root / "agent" / "tool").chmod(0o700)
    (root / "agent" / "config").symlink_to("../config")
    (root / "config" / "umlaut-ä.toml").write_text("")
    git(root, "init", "--quiet")
    git(root, "add", ".")
    who = ("-c", "user.name=A", "-c", "user.email=a@localhost", "-c", "commit.gpgsign=false")
    git(root, *who, "commit", "--quiet", "--message", "first", "--date", f"{TIME} +0000")
    return root


def modes(folder: Path) -> dict[str, str]:
    return {
        path.relative_to(folder).as_posix(): "link" if path.is_symlink() else f"{path.stat().st_mode & 0o777:o}"
        for path in folder.rglob("*")
        if path.is_symlink() or path.is_file()
    }


def test_only_tracked_files_are_copied_with_the_modes_of_git(checkout: Path, tmp_path: Path) -> None:
    (checkout / "agent" / "left-over.py").write_text("")
    export_tracked(checkout, tmp_path / "copy", ("agent", "config"))
    assert modes(tmp_path / "copy") == {
        "agent/main.py": "644",
        "agent/tool": "755",
        "agent/config": "link",
        "config/umlaut-ä.toml": "644",
    }


def test_a_release_is_made_only_from_a_commit(checkout: Path) -> None:
    require_clean(checkout)
    (checkout / "agent" / "main.py").write_text("changed")
    with pytest.raises(ReleaseRefused, match=r"agent/main\.py differs from the last commit"):
        require_clean(checkout)


def test_the_time_is_that_of_the_commit_or_the_stated_one(checkout: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SOURCE_DATE_EPOCH", raising=False)
    assert commit_time(checkout) == int(git(checkout, "log", "-1", "--format=%ct"))
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "17")
    assert commit_time(checkout) == 17
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "yesterday")
    with pytest.raises(ReleaseRefused, match="SOURCE_DATE_EPOCH is `yesterday`"):
        commit_time(checkout)


def test_a_folder_that_is_no_checkout_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    monkeypatch.delenv("SOURCE_DATE_EPOCH", raising=False)
    with pytest.raises(ReleaseRefused, match="is not a git checkout"):
        commit_time(tmp_path)


def package_tree(tree: Path, names: Iterable[str], umask: int) -> Path:
    """Make the tree of a package, its files in this order, as a user with this umask does."""
    former = os.umask(umask)
    try:
        (tree / "DEBIAN").mkdir(parents=True)
        (tree / "DEBIAN" / "control").write_text(CONTROL)
        for name in names:
            mode, text = FILES[name]
            (tree / name).parent.mkdir(parents=True, exist_ok=True)
            (tree / name).write_text(text)
            (tree / name).chmod(mode & ~umask)
        (tree / "usr/share/link").symlink_to("a")
    finally:
        os.umask(former)
    return tree


def test_two_trees_with_the_same_files_give_the_same_package(tmp_path: Path) -> None:
    first = package_tree(tmp_path / "one" / "tree", sorted(FILES), 0o022)
    second = package_tree(tmp_path / "another" / "tree", sorted(FILES, reverse=True), 0o077)
    packages = [pack(tree, tree.parent / "out", "1", TIME) for tree in (first, second)]
    assert packages[0].read_bytes() == packages[1].read_bytes()
    listed = subprocess.run(["dpkg-deb", "--contents", packages[1]], check=True, stdout=subprocess.PIPE, text=True)
    assert "-rwxr-xr-x root/root" in listed.stdout
    assert "-rw-r--r-- root/root" in listed.stdout
