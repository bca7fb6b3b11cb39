"""Functions that read files and report errors in plain words, and functions that write a file either completely and
durably or not at all.

This module reads and writes the text of files; the package `twin.formats` converts text to values. The function
`translated` turns errors of the package `twin` into errors of the application, with the same message, locations and
hint.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from drivers.errors import InputError, UserError, VolcalError
from drivers.foreign_errors import cause_of
from drivers.tables.files import sync_directory
from twin.errors import TwinError
from twin.formats.compressed_text import MAGIC, MAX_TEXT_BYTES, SUFFIX, expand_text

FILE_MODE = 0o644
"""Mode of result files: readable by other users and programs, unlike the files that `mkstemp` creates."""


def read_text(path: Path, *, error: type[UserError] = InputError) -> str:
    """Return the text of a file, which may be compressed (see `present_file`). Raises an error of class `error` if the
    file cannot be read, is longer than MAX_TEXT_BYTES, or is not UTF-8 text."""
    try:
        path = present_file(path)
        with path.open("rb") as file:
            content = file.read(MAX_TEXT_BYTES + 1)
        if len(content) > MAX_TEXT_BYTES:
            message = f"the file is larger than {MAX_TEXT_BYTES // 1_000_000} MB"
            raise error(message, hint="check that this is the right file", file=str(path))
        if content.startswith(MAGIC):
            with translated(error, file=str(path)):
                content = expand_text(content)
        return content.decode("utf-8-sig")
    except FileNotFoundError:
        raise error("there is no such file", hint="check the path", file=str(path)) from None
    except IsADirectoryError:
        raise error("this is a directory, a file is needed", file=str(path)) from None
    except UnicodeDecodeError as cause:
        line = cause.object.count(b"\n", 0, cause.start) + 1
        hint = "save it as plain UTF-8 text (from a spreadsheet: CSV UTF-8)"
        raise error("the file is not UTF-8 text", hint=hint, file=str(path), line=line) from None
    except OSError as cause:
        raise error(f"the file cannot be read: {cause_of(cause)}", file=str(path)) from None


def present_file(path: Path) -> Path:
    """Return the path of the compressed file, whose name has the further ending `.gz`, if there is no file at `path`
    but a compressed one. Otherwise return `path`."""
    compressed = path.with_name(path.name + SUFFIX) if path.name else path
    return compressed if not path.exists() and compressed.is_file() else path


@contextmanager
def translated(error: type[VolcalError] = InputError, **where: str | int) -> Iterator[None]:
    """Turn a `TwinError` (an error of the package `twin`) raised in the `with` block into an error of the class `error`
    with the same message, locations and hint.

    Locations say what the error refers to, such as a file or a settings key. `where` contains further locations to be
    added to the error.
    """
    try:
        yield
    except TwinError as cause:
        raise error(cause.message, hint=cause.hint, **cause.where).at(**where) from cause


def write_atomically(path: Path, text: str, mode: int = FILE_MODE) -> None:
    """Write `text` to the file `path`, so that it is on the disk when the function returns.

    If the write is interrupted, the file at `path` contains either its old text or the new text. `mode` contains the
    permission bits of the file.
    """
    write_all_atomically(path.parent, {path.name: text}, mode=mode)


def write_all_atomically(
    directory: Path, contents: Mapping[str, str | bytes], removed: Iterable[str] = (), mode: int = FILE_MODE
) -> None:
    """Write several files into `directory`, which is created if it is missing. `contents` maps file names to contents.

    All files are written completely to the disk under temporary names before the first file is renamed. If a file
    cannot be written, InputError is raised and none of the files appears. The files whose names are in `removed` are
    deleted at the end if they exist: they belong to results that the new files replace.
    """
    staged: dict[Path, Path] = {}
    try:
        create_directory(directory)
        for name, content in contents.items():
            target = directory / name
            if target.is_dir():
                raise InputError("there is a directory in place of a file to be written", file=str(target))
            staged[target] = _stage(directory, name, content, mode)
        for target, temporary in staged.items():
            temporary.replace(target)
        for name in removed:
            (directory / name).unlink(missing_ok=True)
        sync_directory(directory)
    except (FileExistsError, NotADirectoryError):
        raise _file_in_the_way(directory) from None
    except OSError as cause:
        hint = "check the permissions and the free space"
        message = f"results cannot be written: {cause_of(cause)}"
        raise InputError(message, hint=hint, directory=str(directory)) from None
    finally:
        for temporary in staged.values():
            temporary.unlink(missing_ok=True)


def create_directory(directory: Path) -> None:
    """Create `directory`, and the directories above it that are missing, so that they are on the disk when the function
    returns: otherwise a power cut could lose them with files in them that are on the disk. Raises OSError."""
    missing = [directory, *directory.parents]
    missing = [path for path in missing if not path.is_dir()]
    directory.mkdir(parents=True, exist_ok=True)
    for path in missing:
        sync_directory(path.parent)


def check_folder(folder: Path) -> None:
    """Raise InputError if files cannot be written into `folder`.

    Commands make this check before they spend time on computing the contents of the files. The check leaves no file
    behind.
    """
    nearest = next(path for path in (folder.absolute(), *folder.absolute().parents) if path.exists())
    if not nearest.is_dir():
        raise _file_in_the_way(nearest)
    try:
        tempfile.TemporaryFile(dir=nearest).close()
    except OSError as cause:
        hint = "check the permissions and the free space, or choose another directory"
        message = f"results cannot be written: {cause_of(cause)}"
        raise InputError(message, hint=hint, directory=str(folder)) from None


def _file_in_the_way(path: Path) -> InputError:
    return InputError("this is a file, a directory is needed", hint="choose another directory", file=str(path))


@contextmanager
def streamed_atomically(path: Path) -> Iterator[TextIO]:
    """Yield a temporary text file that the caller writes piece by piece.

    At the end of the `with` block, the temporary file is renamed to `path`. If the block raises an error, the temporary
    file is deleted.

    Bytes that were not valid UTF-8 when they were read with the error handler `surrogateescape` are written unchanged.
    Line ends are not changed.
    """
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    except OSError as cause:
        raise InputError(f"results cannot be written: {cause_of(cause)}", file=str(path)) from None
    temporary = Path(name)
    try:
        with os.fdopen(handle, "w", encoding="utf-8", errors="surrogateescape", newline="") as file:
            yield file
            file.flush()
            os.fchmod(file.fileno(), FILE_MODE)
            os.fsync(file.fileno())
        temporary.replace(path)
        sync_directory(path.parent)
    except OSError as cause:
        hint = "check the permissions and the free space"
        raise InputError(f"results cannot be written: {cause_of(cause)}", hint=hint, file=str(path)) from None
    finally:
        temporary.unlink(missing_ok=True)


def _stage(directory: Path, name: str, content: str | bytes, mode: int) -> Path:
    handle, temporary = tempfile.mkstemp(dir=directory, prefix=f".{name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content.encode() if isinstance(content, str) else content)
            file.flush()
            os.fchmod(file.fileno(), mode)
            os.fsync(file.fileno())
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
    return Path(temporary)
