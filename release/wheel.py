"""Command `make wheel`: the wheel of volcal, from the files that git tracks. The same commit gives the same bytes.

    python -m release.wheel [--out dist]

It is built by the pinned setuptools of this environment, not by a newer one that an isolated build would fetch.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
from pathlib import Path

from release.errors import ReleaseRefused
from release.packages import ROOT
from release.source import commit_time, export_tracked

SOURCES = (
    "agent",
    "config",
    "drivers",
    "gcode",
    "simulators",
    "twin",
    "volcal",
    "pyproject.toml",
    "README.md",
    "LICENSE",
)
_PROGRAM = """
import os, sys
os.umask(0o022)
from setuptools.build_meta import build_wheel
build_wheel(sys.argv[1])
"""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "dist", help="output directory")
    given = parser.parse_args()
    try:
        print(build_wheel(ROOT, ROOT / "build" / "wheel", given.out.resolve(), commit_time(ROOT)))
    except ReleaseRefused as error:
        print(error, file=sys.stderr)
        return 1
    return 0


def build_wheel(root: Path, work: Path, out: Path, time: int) -> Path:
    """Build the wheel from the tracked files below `root` and return its path in the folder `out`.

    `work` is a folder for the source, made anew. `time` is the UTC time of all files in s since 1970. Modes do not
    depend on the umask, nor the order of files on the disk.
    """
    source = work / "source"
    shutil.rmtree(source, ignore_errors=True)
    export_tracked(root, source, SOURCES)
    out.mkdir(parents=True, exist_ok=True)
    for former in out.glob("volcal-*.whl"):
        former.unlink()
    environment = {**os.environ, "SOURCE_DATE_EPOCH": str(time)}
    command = [sys.executable, "-c", _PROGRAM, str(out)]
    done = subprocess.run(command, check=False, cwd=source, env=environment, capture_output=True, text=True)
    if done.returncode != 0:
        raise ReleaseRefused(f"setuptools cannot build the wheel:\n{done.stderr.strip()}")
    (built,) = out.glob("volcal-*.whl")
    return built


if __name__ == "__main__":
    sys.exit(main())
