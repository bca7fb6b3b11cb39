"""Causes of errors of libraries and of the operating system, in our own words.

What a library says is written for programmers, in its own language: it goes to the log, and never to an operator.
"""

from __future__ import annotations

import errno
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    import ssl

IN_THE_LOG: Final = "the log names the cause"
_PRIMARY_CODE: Final = 0xFF
"""Mask of the primary result code in an extended result code of SQLite."""

BY_ERRNO: Final = MappingProxyType(
    {
        errno.ECONNREFUSED: "connection refused",
        errno.ECONNRESET: "connection closed by the peer",
        errno.EPIPE: "connection closed by the peer",
        errno.ECONNABORTED: "connection aborted",
        errno.ETIMEDOUT: "no answer",
        errno.EHOSTUNREACH: "no route to this address",
        errno.ENETUNREACH: "network unreachable",
        errno.ENETDOWN: "network interface down",
        errno.EADDRINUSE: "the port is in use by another program",
        errno.EADDRNOTAVAIL: "this computer does not have this address",
        errno.ENOENT: "not found",
        errno.ENODEV: "no such device",
        errno.ENXIO: "no such device",
        errno.EBUSY: "in use by another program",
        errno.EAGAIN: "in use by another program",
        errno.EACCES: "no permission",
        errno.EPERM: "no permission",
        errno.EROFS: "read-only file system",
        errno.ENOSPC: "no space left on the disk",
        errno.EDQUOT: "disk quota exceeded",
        errno.EIO: "input/output error",
        errno.EMFILE: "too many open files",
        errno.ENOTDIR: "not a directory",
        errno.EISDIR: "is a directory",
        errno.EEXIST: "a file of this name exists",
        errno.ENAMETOOLONG: "the name is too long",
        errno.ENOMEM: "out of memory",
        errno.ENOBUFS: "the queue of the network interface is full",
    }
)

# by the result codes of https://sqlite.org/rescode.html
BY_SQLITE_CODE: Final = MappingProxyType(
    {
        3: "no permission",
        5: "in use by another program",
        6: "in use by another program",
        7: "out of memory",
        8: "the file is read-only",
        10: "input/output error",
        11: "the file is damaged",
        13: "no space left on the disk",
        14: "the file cannot be opened",
        26: "the file is not a database",
    }
)

# by the codes of https://docs.openssl.org/master/man3/X509_STORE_CTX_get_error/
BY_CERTIFICATE_CODE: Final = MappingProxyType(
    {
        2: "its issuer is not known",
        9: "it is not valid yet",
        10: "it has expired",
        18: "it is signed by itself",
        19: "its chain ends with one that is signed by itself",
        20: "its issuer is not known",
        21: "its chain is not complete",
        23: "it is revoked",
        62: "it is for another name",
        64: "it is for another address",
    }
)
UNKNOWN_NAME: Final = "the name of the host is not known"
NO_TLS: Final = "no TLS connection can be made"
NO_ANSWER: Final = "no answer"


class OurWords:
    """Mixin for an error class of a library that we raise ourselves: its text is ours and may be shown."""


def cause_of(error: BaseException) -> str:
    """Return the cause of `error` in our own words.

    The cause is that of the error itself or of the nearest error that it was raised from. If it is unknown, `error` is
    written to the log, and the text says so.
    """
    link: BaseException | None = error
    while link is not None:
        if isinstance(link, OurWords):
            return str(link)
        code = getattr(link, "sqlite_errorcode", None)
        known = BY_SQLITE_CODE.get(code & _PRIMARY_CODE) if isinstance(code, int) else _of_number(link)
        if known is not None:
            return known
        link = link.__cause__ or (None if link.__suppress_context__ else link.__context__)
    import structlog  # noqa: PLC0415  commands that log nothing start without it

    structlog.get_logger("foreign_errors").warning("error of a library or of the operating system", error=repr(error))
    return IN_THE_LOG


def certificate_cause(error: ssl.SSLCertVerificationError) -> str:
    """Return why a certificate is not accepted, in our own words."""
    return BY_CERTIFICATE_CODE.get(error.verify_code, f"code {error.verify_code} of OpenSSL")


def _of_number(error: BaseException) -> str | None:
    """Return the cause of an error of the operating system.

    Errors of names and of TLS are of the same class with numbers of their own, which mean something else.
    """
    if not isinstance(error, OSError):
        return None
    import socket  # noqa: PLC0415  only once something has failed
    import ssl  # noqa: PLC0415

    if isinstance(error, socket.gaierror | socket.herror):
        return UNKNOWN_NAME
    if isinstance(error, ssl.SSLCertVerificationError):
        return f"the certificate is not accepted: {certificate_cause(error)}"
    if isinstance(error, ssl.SSLError):
        return NO_TLS
    if error.errno is None:
        return NO_ANSWER if isinstance(error, TimeoutError) else None
    return BY_ERRNO.get(error.errno)
