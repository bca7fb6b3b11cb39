"""What a library says is in the log; an error tells its cause in our own words."""

from __future__ import annotations

import errno
import socket
import sqlite3
import ssl
from contextlib import closing
from pathlib import Path

import pytest
from structlog.testing import capture_logs

from drivers.foreign_errors import IN_THE_LOG, OurWords, cause_of


class Own(OurWords, OSError):
    pass


def expired_certificate() -> ssl.SSLCertVerificationError:
    error = ssl.SSLCertVerificationError(1, "certificate verify failed: certificate has expired")
    error.verify_code = 10
    return error


def raised_from(cause: Exception) -> Exception:
    try:
        try:
            raise cause
        except Exception as error:
            raise ValueError("Modbus Error: unbounded read bytes") from error
    except ValueError as error:
        return error


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (ConnectionRefusedError(errno.ECONNREFUSED, "Connection refused"), "connection refused"),
        (raised_from(OSError(errno.ENOSPC, "No space left on device")), "no space left on the disk"),
        (TimeoutError("timed out"), "no answer"),
        (OSError(errno.ENOBUFS, "No buffer space available"), "the queue of the network interface is full"),
        (socket.gaierror(socket.EAI_NONAME, "Name or service not known"), "the name of the host is not known"),
        (ssl.SSLError(1, "[SSL: WRONG_VERSION_NUMBER] wrong version number"), "no TLS connection can be made"),
        (expired_certificate(), "the certificate is not accepted: it has expired"),
        (raised_from(Own("the adapter has gone")), "the adapter has gone"),
    ],
)
def test_a_known_cause_is_told_in_our_words(error: Exception, words: str) -> None:
    with capture_logs() as logs:
        assert cause_of(error) == words
    assert logs == []


def test_an_unknown_cause_is_in_the_log_alone() -> None:
    with capture_logs() as logs:
        assert cause_of(raised_from(KeyError("tripped"))) == IN_THE_LOG
    (entry,) = logs
    assert "unbounded read bytes" in entry["error"]


def test_causes_of_the_database_are_known_by_their_codes(tmp_path: Path) -> None:
    path = tmp_path / "journal.db"
    path.write_bytes(b"no database" * 100)
    with closing(sqlite3.connect(path)) as connection, pytest.raises(sqlite3.Error) as caught:
        connection.execute("SELECT * FROM runs")
    assert cause_of(caught.value) == "the file is not a database"
