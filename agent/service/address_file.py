"""Address file of the running service in the state directory. The HTTP endpoint writes the file, and the command-line
commands read it."""

from __future__ import annotations

import json
import os
from pathlib import Path

from agent.files import write_atomically

ADDRESS_FILE = "service.json"


def write_address(directory: Path, url: str) -> None:
    """Write `url` to the address file. Command-line commands use this file to find the service, which runs in this
    process."""
    write_atomically(directory / ADDRESS_FILE, json.dumps({"url": url, "process": os.getpid()}))


def remove_address(directory: Path) -> None:
    (directory / ADDRESS_FILE).unlink(missing_ok=True)


def read_address(directory: Path) -> str:
    """Return the URL of the running service from the address file.

    Raise FileNotFoundError if no service runs, and OSError, ValueError or KeyError if the file is invalid.
    """
    return str(json.loads((directory / ADDRESS_FILE).read_text(encoding="utf-8"))["url"])
