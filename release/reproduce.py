"""Command `make reproducible`: builds the wheel and the Debian package of the last commit twice and compares the bytes.

The two clones have other paths, umasks, time zones and languages.

    python -m release.reproduce

Takes some minutes. Ends with one line of JSON; the exit code is 0 only if both builds are the same.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from hashlib import file_digest
from pathlib import Path

from release.packages import ROOT
from release.source import git

PLACES: Mapping[str, tuple[int, Mapping[str, str]]] = {
    "a": (0o022, {"TZ": "UTC", "LC_ALL": "C.UTF-8", "PYTHONHASHSEED": "1"}),
    "a-much-longer-name-of-a-folder": (0o077, {"TZ": "Pacific/Auckland", "LC_ALL": "C", "PYTHONHASHSEED": "2"}),
}
"""Folder of each clone with its umask and its environment."""
COMMANDS = ("release.wheel", "release.deb")


def main() -> int:
    commit = git(ROOT, "rev-parse", "HEAD")  # the checkout may go on while this builds
    with tempfile.TemporaryDirectory() as folder:
        builds = [
            build_clone(commit, Path(folder) / name, umask, environment)
            for name, (umask, environment) in PLACES.items()
        ]
    equal = builds[0] == builds[1]
    different = sorted(name for name in builds[0] if builds[0][name] != builds[1].get(name))
    print(json.dumps({"passed": equal, "sha256": builds[0], "different": different}))
    return 0 if equal else 1


def build_clone(commit: str, clone: Path, umask: int, environment: Mapping[str, str]) -> dict[str, str]:
    """Build the release files of a commit in a new clone and return their SHA-256 sums by name."""
    git(ROOT, "clone", "--quiet", "--no-hardlinks", str(ROOT), str(clone))
    git(clone, "checkout", "--quiet", "--detach", commit)
    for command in COMMANDS:
        words = [sys.executable, "-m", command, "--out", str(clone / "dist")]
        subprocess.run(words, check=True, cwd=clone, umask=umask, env={**os.environ, **environment}, stdout=sys.stderr)
    return {path.name: _sum(path) for path in sorted((clone / "dist").iterdir())}


def _sum(path: Path) -> str:
    with path.open("rb") as content:
        return file_digest(content, "sha256").hexdigest()


if __name__ == "__main__":
    sys.exit(main())
