"""A campaign run as its command, with the object in the last line of its output."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]


def run_campaign(name: str, *arguments: str | Path) -> tuple[int, dict[str, Any]]:
    """Run `python -m campaigns.NAME`, and return its exit code and what it found."""
    command = [sys.executable, "-m", f"campaigns.{name}", *map(str, arguments)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=1150.0, check=False)
    assert done.stdout, done.stderr
    return done.returncode, json.loads(done.stdout.splitlines()[-1])
