"""Where the service can be reached, kept in the state directory while it lives: told by its door, read by commands."""

from __future__ import annotations

import json
import os
from pathlib import Path

from agent.files import write_atomically

PLACE_FILE = "service.json"


def tell(directory: Path, url: str) -> None:
    """From now on commands find the service of this process at `url`."""
    write_atomically(directory / PLACE_FILE, json.dumps({"url": url, "process": os.getpid()}))


def withdraw(directory: Path) -> None:
    (directory / PLACE_FILE).unlink(missing_ok=True)


def told(directory: Path) -> str:
    """The URL. FileNotFoundError where no service lives; OSError, ValueError or KeyError where the file is no such."""
    return str(json.loads((directory / PLACE_FILE).read_text(encoding="utf-8"))["url"])
