"""INI file of LinuxCNC as bytes, to which marked lines are added and from which they are taken out again.

Only lines between two marks are ever added or removed; every other byte stays as it is, whatever its encoding and line
ends. As in LinuxCNC, the first section of a name counts and a key may be repeated.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from drivers.errors import InputError

BEGIN = b"# >>> volcal linuxcnc install"
BEGIN_AFTER_OPEN_LINE = BEGIN + b" (the line before had no line end)"
END = b"# <<< volcal linuxcnc install"
OTHER_ENCODINGS = (b"\xff\xfe", b"\xfe\xff")


@dataclass(frozen=True)
class Section:
    """Section of an INI file: index of its header line, and of the line after its last line."""

    header: int
    end: int


class IniFile:
    """Lines of an INI file. `path` is for messages only; nothing is written."""

    def __init__(self, path: Path, content: bytes) -> None:
        if content.startswith(OTHER_ENCODINGS) or b"\0" in content:
            raise InputError(
                "the file is UTF-16, which LinuxCNC cannot read", hint="save it as plain text", file=str(path)
            )
        self.path = path
        self._lines = content.splitlines(keepends=True) if b"\n" in content else [content]
        if b"\r" in content.replace(b"\r\n", b""):
            raise InputError("a line ends with CR alone", hint="save it with Unix line ends", file=str(path))

    def content(self) -> bytes:
        return b"".join(self._lines)

    def section(self, name: str) -> Section | None:
        header = None
        for index, line in enumerate(self._lines):
            text = line.strip()
            if not text.startswith(b"["):
                continue
            if header is not None:
                return Section(header, index)
            if text.partition(b"]")[0] == b"[" + name.encode():
                header = index
        return None if header is None else Section(header, len(self._lines))

    def require_section(self, name: str, hint: str = "is this the INI file of LinuxCNC?") -> Section:
        """Return a section. Raises InputError, with `hint`, if the file has none of this name."""
        found = self.section(name)
        if found is not None:
            return found
        included = any(line.lstrip().startswith(b"#INCLUDE") for line in self._lines)
        if included:
            hint = "it may be in an #INCLUDE file, which is not changed: add the lines by hand"
        raise InputError(f"no section [{name}]", hint=hint, file=str(self.path))

    def entries(self, section: Section) -> Iterator[tuple[int, str, str]]:
        """Yield the line index, the key and the value of each entry of a section."""
        for index in range(section.header + 1, section.end):
            text = self._lines[index].strip()
            key, equals, value = text.partition(b"=")
            if equals and not text.startswith((b"#", b";")):
                yield index, _decoded(key), _decoded(value.partition(b"#")[0])

    def value(self, section: Section, key: str) -> str | None:
        return next((value for _, one, value in self.entries(section) if one == key), None)

    def insert_after(self, index: int, *lines: str) -> None:
        """Insert lines after the line `index`, or after the marked block that contains this line.

        A comment line before them and one after them mark them as added by volcal. They end with the same line end as
        the line at `index`.
        """
        index = self._end_of_block(index)
        before = self._lines[index]
        is_open = not before.endswith(b"\n")
        usual = before if not is_open else self._lines[0]
        end = b"\r\n" if usual.endswith(b"\r\n") else b"\n"
        block = [BEGIN_AFTER_OPEN_LINE if is_open else BEGIN, *(line.encode() for line in lines), END]
        if is_open:
            self._lines[index : index + 1] = [before + end, *(line + end for line in block[:-1]), END]
        else:
            self._lines[index + 1 : index + 1] = [line + end for line in block]

    def _end_of_block(self, index: int) -> int:
        """Return the index of the end mark of the block that contains a line, or the line's own index."""
        for mark in reversed(range(index + 1)):
            if self._lines[mark].strip() == END:
                return index
            if self._lines[mark].startswith(BEGIN):
                return next(n for n in range(index, len(self._lines)) if self._lines[n].strip() == END)
        return index

    def append(self, *lines: str) -> None:
        self.insert_after(len(self._lines) - 1, *lines)

    def without_marked_lines(self) -> bytes:
        """Return the content without the marked blocks. Raises InputError if a mark is missing."""
        kept: list[bytes] = []
        begun: int | None = None
        for number, line in enumerate(self._lines, start=1):
            text = line.strip()
            if text.startswith(BEGIN):
                if begun is not None:
                    raise self._unbalanced(begun)
                begun = number
                if text == BEGIN_AFTER_OPEN_LINE and kept:
                    kept[-1] = kept[-1].rstrip(b"\r\n")
            elif text == END:
                if begun is None:
                    raise self._unbalanced(number)
                begun = None
            elif begun is None:
                if kept and not kept[-1].endswith(b"\n"):  # something was appended after the last block
                    kept[-1] += b"\r\n" if line.endswith(b"\r\n") else b"\n"
                kept.append(line)
        if begun is not None:
            raise self._unbalanced(begun)
        return b"".join(kept)

    def _unbalanced(self, line: int) -> InputError:
        return InputError(
            "a mark of `volcal linuxcnc install` has lost its partner",
            hint=f"restore the pair of lines '{BEGIN.decode()}' and '{END.decode()}'",
            file=str(self.path),
            line=line,
        )


def _decoded(text: bytes) -> str:
    return text.strip().decode("utf-8", "surrogateescape")
