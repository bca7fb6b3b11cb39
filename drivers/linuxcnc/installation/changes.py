"""Changes of files: shown as a difference, and carried out so that each file is written whole or not at all."""

from __future__ import annotations

import os
import stat
import tempfile
from contextlib import suppress
from dataclasses import dataclass
from difflib import unified_diff
from pathlib import Path

from drivers.errors import InputError
from drivers.tables.files import sync_directory


@dataclass(frozen=True)
class FileChange:
    """New content of a file; `before` or `after` is None if the file does not exist then."""

    path: Path
    before: bytes | None
    after: bytes | None

    def description(self) -> str:
        """Return the name of a new or deleted file, or the change of a file as a unified difference."""
        if self.before is None or self.after is None:
            return f"{'new file' if self.before is None else 'deleted'}: {self.path}"
        name = str(self.path)
        lines = unified_diff(_lines(self.before), _lines(self.after), name, name, n=1)
        return "\n".join(line.rstrip("\r\n") for line in lines)


def require_writable(path: Path) -> None:
    """Raise InputError if a file, or a new file in its directory, cannot be written.

    A write-protected file is refused for root as well, who could write it.
    """
    target = path if path.exists() else path.parent
    if not target.stat().st_mode & stat.S_IWUSR or not os.access(target, os.W_OK):
        raise InputError("this is write-protected", hint="make it writable for you first", file=str(target))
    if not os.access(path.parent, os.W_OK):
        raise InputError("the directory is write-protected", hint="make it writable for you first", file=str(path))


def carry_out(changes: list[FileChange]) -> None:
    """Write all changes. If one fails, those already made are undone."""
    done: list[FileChange] = []
    try:
        for change in changes:
            _write(change.path, change.after)
            done.append(change)
    except OSError as error:
        for change in reversed(done):
            with suppress(OSError):
                _write(change.path, change.before)
        raise InputError(
            f"the file cannot be written: {error.strerror}; nothing was changed", file=str(change.path)
        ) from error


def _write(path: Path, content: bytes | None) -> None:
    if content is None:
        path.unlink()
        return
    real = path.resolve()
    former = real.stat() if real.exists() else None
    handle, name = tempfile.mkstemp(dir=real.parent, prefix=f".{real.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
            file.flush()
            os.fchmod(file.fileno(), stat.S_IMODE(former.st_mode) if former else 0o644)
            if former and (former.st_uid, former.st_gid) != (os.geteuid(), os.getegid()):
                os.fchown(file.fileno(), former.st_uid, former.st_gid)
            os.fsync(file.fileno())
        Path(name).replace(real)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
    sync_directory(real.parent)


def _lines(content: bytes) -> list[str]:
    return content.decode("utf-8", "replace").splitlines(keepends=True)
