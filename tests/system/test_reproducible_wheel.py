"""The wheel, built twice by the real command in two clones, has the same bytes."""

from __future__ import annotations

import os
import stat
import subprocess
import sys
import zipfile
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

from release.packages import ROOT
from release.source import git
from release.wheel import SOURCES


def wheel(clone: Path, umask: int, environment: Mapping[str, str]) -> Path:
    git(ROOT, "clone", "--quiet", "--no-hardlinks", "--depth", "1", f"file://{ROOT}", str(clone))
    given = {name: value for name, value in os.environ.items() if name != "SOURCE_DATE_EPOCH"}
    done = subprocess.run(
        [sys.executable, "-m", "release.wheel"],
        check=True, cwd=clone, umask=umask, env={**given, **environment}, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    path = Path(done.stdout.strip())
    assert path.parent == clone / "dist"
    return path


def test_two_builds_of_one_commit_have_the_same_bytes(tmp_path: Path) -> None:
    first = wheel(tmp_path / "a", 0o022, {"TZ": "UTC", "PYTHONHASHSEED": "1"})
    second = wheel(tmp_path / "a-longer-name", 0o077, {"TZ": "Pacific/Auckland", "PYTHONHASHSEED": "2"})
    assert first.name == second.name
    assert first.read_bytes() == second.read_bytes()
    time = datetime.fromtimestamp(int(git(ROOT, "log", "-1", "--format=%ct")), UTC)
    with zipfile.ZipFile(first) as content:
        entries = content.infolist()
    # A ZIP archive states times to two seconds.
    assert {one.date_time[:5] for one in entries} == {(time.year, time.month, time.day, time.hour, time.minute)}
    # Not those of either umask; the tool that writes the wheel gives its RECORD 664.
    assert {stat.S_IMODE(one.external_attr >> 16) for one in entries} == {0o644, 0o664, 0o755}
    assert any(one.filename.startswith("volcal/config/") for one in entries)
    assert {one.filename.split("/")[0] for one in entries} - {*SOURCES} == {f"{first.name.rsplit('-', 3)[0]}.dist-info"}
