"""Source of a release: the files of one commit."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

from release.errors import ReleaseRefused

TEXT, PROGRAM = 0o644, 0o755
_GIT_PROGRAM, _GIT_LINK = "100755", "120000"


def commit_time(root: Path) -> int:
    """Return the UTC time of the last commit below `root` in s since 1970, or SOURCE_DATE_EPOCH if it is set and not
    empty."""
    given = os.environ.get("SOURCE_DATE_EPOCH")
    if given and not (given.isascii() and given.isdecimal()):
        raise ReleaseRefused(f"SOURCE_DATE_EPOCH is `{given}`; it must be a number of seconds since 1970")
    return int(given or git(root, "log", "-1", "--format=%ct"))


def require_clean(root: Path) -> None:
    """Raise ReleaseRefused if a file differs from the last commit: the release would not be that of the commit."""
    changed = git(root, "status", "--porcelain").splitlines()
    if changed:
        raise ReleaseRefused(f"{changed[0][3:]} differs from the last commit or is not in it; commit or remove it")


def export_tracked(root: Path, target: Path, names: tuple[str, ...]) -> None:
    """Copy the files below `names` that git tracks to the folder `target`, with modes that depend on git alone.

    An archive made from a checkout would contain what else lies there, and modes that depend on the umask.
    """
    for line in filter(None, git(root, "ls-files", "--stage", "-z", *names).split("\0")):
        about, name = line.split("\t", 1)
        mode, copied = about.split(" ", 1)[0], target / name
        copied.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(root / name, copied, follow_symlinks=False)
        if mode != _GIT_LINK:
            copied.chmod(PROGRAM if mode == _GIT_PROGRAM else TEXT)


def git(root: Path, *words: str) -> str:
    """Return the output of a git command in the checkout `root`."""
    done = subprocess.run(["git", "-C", str(root), *words], check=False, capture_output=True, text=True)
    if done.returncode != 0:
        raise ReleaseRefused(f"{root} is not a git checkout that can be read: {done.stderr.strip()}")
    return done.stdout.strip("\n") if "-z" not in words else done.stdout
