"""Folder of the release files: what of a former release may be replaced, and what must not be touched."""

from __future__ import annotations

import shutil
from fnmatch import fnmatchcase
from pathlib import Path

from release.errors import ReleaseRefused
from release.pins import CONSTRAINTS
from release.signature import SIGNATURE, SUMS

RELEASE_FILES = ("volcal-*.whl", "volcal_*.deb", "volcal-*.cdx.json", CONSTRAINTS, SUMS, SIGNATURE)
"""Patterns of the names of all files of a release."""


def require_replaceable(out: Path, root: Path) -> None:
    """Raise ReleaseRefused unless the folder `out` is missing, empty or contains a former release and nothing else, and
    does not contain the checkout `root`."""
    if root.resolve().is_relative_to(out.resolve()):
        raise ReleaseRefused(f"{out} contains the checkout; choose another folder with --out")
    if not out.exists():
        return
    if not out.is_dir():
        raise ReleaseRefused(f"{out} is not a folder; choose another one with --out")
    foreign = [path for path in sorted(out.iterdir()) if not _is_release_file(path)]
    if foreign:
        raise ReleaseRefused(f"{foreign[0]} is no file of a release; choose an empty folder with --out")
    if any(out.iterdir()) and not (out / SUMS).is_file():
        raise ReleaseRefused(f"{out} is not empty and contains no {SUMS} of a former release; choose an empty folder")


def replace_release(out: Path, made: Path) -> None:
    """Replace the former release in the folder `out`, if there is one, by the files in the folder `made`."""
    out.mkdir(parents=True, exist_ok=True)
    for former in out.iterdir():
        if _is_release_file(former):
            former.unlink()
    # The sums come first: if this is interrupted, the rest is still known as part of a release.
    for path in sorted(made.iterdir(), key=lambda one: (one.name != SUMS, one.name)):
        shutil.copyfile(path, out / path.name)


def _is_release_file(path: Path) -> bool:
    is_file = path.is_file() or path.is_symlink()
    return is_file and any(fnmatchcase(path.name, pattern) for pattern in RELEASE_FILES)
