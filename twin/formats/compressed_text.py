"""Compressed texts in the format gzip (RFC 1952), which contains a checksum of the text.

A few bytes can be expanded to a text of any length, so a text is expanded only up to a limit.
"""

from __future__ import annotations

import gzip
import zlib

from twin.errors import FormatError

MAX_TEXT_BYTES = 64_000_000
"""Longest text that is read, which takes some seconds. Texts of measurements and estimates are shorter."""
SUFFIX = ".gz"
"""End of the name of a compressed file."""
MAGIC = b"\x1f\x8b"
"""First bytes of a compressed text. No UTF-8 text begins with them."""
_GZIP_WINDOW = 16 + zlib.MAX_WBITS
_LEVEL = 6
_HINT = "take it from a backup"


def compress_text(text: bytes) -> bytes:
    """Return the compressed form of a UTF-8 text. The same text always has the same form."""
    return gzip.compress(text, _LEVEL, mtime=0)


def expand_text(content: bytes, longest: int = MAX_TEXT_BYTES) -> bytes:
    """Return the text of which `content` is the compressed form.

    Raises FormatError if `content` is damaged or incomplete, and if the text is longer than `longest` bytes. Not more
    than `longest` bytes and one are ever expanded.
    """
    expansion = zlib.decompressobj(_GZIP_WINDOW)
    try:
        text = expansion.decompress(content, longest + 1)
    except zlib.error as error:
        raise FormatError(f"the compressed text is damaged ({error})", hint=_HINT) from None
    if len(text) > longest:
        message = f"the compressed text is longer than {longest / 1e6:g} MB"
        raise FormatError(message, hint="check that it is the right one")
    if not expansion.eof or expansion.unused_data:
        raise FormatError("the compressed text is damaged (its end is missing, or more follows)", hint=_HINT)
    return text
