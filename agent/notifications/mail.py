"""Delivery by mail."""

from __future__ import annotations

import smtplib
import socket
import ssl
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime
from email.message import EmailMessage
from email.utils import format_datetime

from agent.notifications.connection import (
    BoundedConnections,
    DeliveryFailed,
    NoticeRefused,
    delivery,
    read_secret,
    tls_context,
)
from agent.notifications.notice import Notice
from agent.printable import one_line
from agent.settings.notifications import MailSettings
from drivers.errors import ConfigurationError

PASSWORD_CREDENTIAL = "mail-password"  # noqa: S105  the name of the credential
_SECTION = "notifications.mail"
_LONGEST_SUBJECT = 150
_READY = 220
_FOR_GOOD = 500
_URGENT = {"info": "normal", "warning": "normal", "alarm": "urgent"}


class _BoundedSmtp(smtplib.SMTP):
    """SMTP client whose connection ends at the deadline of the delivery, with TLS from the start if there is a `tls`
    context."""

    def __init__(self, connections: BoundedConnections, tls: ssl.SSLContext | None) -> None:
        super().__init__(timeout=connections.remaining_s, local_hostname="localhost")  # no search for a name
        self._connections = connections
        self._tls = tls

    def open(self, host: str, port: int) -> None:
        """Connect and read the greeting. Raise SMTPConnectError if the server greets with an error."""
        self._host = host  # STARTTLS checks the certificate against this name
        code, text = self.connect(host, port)
        if code != _READY:
            raise smtplib.SMTPConnectError(code, text)

    def _get_socket(self, host: str, port: int, timeout: float) -> socket.socket:
        plain = self._connections.connect(host, port)
        self.local_hostname = _address_literal(plain.getsockname()[0])
        return plain if self._tls is None else self._tls.wrap_socket(plain, server_hostname=host)


@dataclass(frozen=True)
class MailChannel:
    """Mail server. The name and the password are sent only after TLS has been agreed, or to this computer."""

    settings: MailSettings
    password: str | None = field(repr=False)
    tls: ssl.SSLContext

    def send(self, notice: Notice) -> str:
        settings = self.settings
        receiver = f"mail server {settings.host}"
        with delivery(receiver, settings.timeout_s, (smtplib.SMTPException, ValueError)) as connections:
            client = _BoundedSmtp(connections, self.tls if settings.security == "tls" else None)
            try:
                client.open(settings.host, settings.server_port)
                if settings.security == "starttls":
                    client.starttls(context=self.tls)
                if settings.username is not None and self.password is not None:
                    client.login(settings.username, self.password)
                refused = client.send_message(mail_of(notice, settings), settings.sender, settings.to)
                with suppress(OSError, smtplib.SMTPException):  # the mail is taken, whatever the server says now
                    client.quit()
            except smtplib.SMTPNotSupportedError as error:
                text = "the server does not offer what the settings require: STARTTLS or a log-in with a password"
                raise DeliveryFailed(text, receiver=receiver) from error
            except smtplib.SMTPRecipientsRefused as error:
                raise DeliveryFailed(_refusals(error.recipients), receiver=receiver) from error
            except smtplib.SMTPResponseException as error:
                text = f"the server answers {error.smtp_code}: {_said(error.smtp_error)}"
                of_content = isinstance(error, smtplib.SMTPDataError) and error.smtp_code >= _FOR_GOOD
                raise (NoticeRefused if of_content else DeliveryFailed)(text, receiver=receiver) from error
            finally:
                client.close()
        return _refusals(refused) if refused else ""


def _address_literal(address: str) -> str:
    """Return the address of this computer as the greeting has it (RFC 5321, section 4.1.3): many servers refuse a name
    without a domain."""
    return f"[IPv6:{address.partition('%')[0]}]" if ":" in address else f"[{address}]"


def mail_of(notice: Notice, settings: MailSettings) -> EmailMessage:
    """Return the mail of a notice. Its Message-ID is made of the id of the notice, so that repetitions can be told."""
    mail = EmailMessage()
    mail["Subject"] = one_line(notice.subject, _LONGEST_SUBJECT)
    mail["From"] = settings.sender
    mail["To"] = ", ".join(settings.to)
    mail["Date"] = format_datetime(datetime.fromisoformat(notice.at))
    mail["Message-ID"] = f"<{notice.notice_id}@{settings.sender.partition('@')[2].strip('[]')}>"
    mail["Auto-Submitted"] = "auto-generated"
    mail["Priority"] = _URGENT[notice.severity]
    mail.set_content(notice.text)
    return mail


def mail_channel(settings: MailSettings) -> MailChannel:
    """Return the channel of these settings. Raise ConfigurationError if a file that they name cannot be used, or if
    there is a user name without a password."""
    password = read_secret(PASSWORD_CREDENTIAL, settings.password_file, f"{_SECTION}.password_file")
    require_both(settings.username, password, _SECTION, PASSWORD_CREDENTIAL)
    return MailChannel(settings, password, tls_context(settings.ca_file, f"{_SECTION}.ca_file"))


def require_both(username: str | None, password: str | None, section: str, credential: str) -> None:
    """Raise ConfigurationError if there is a user name without a password, or the reverse."""
    if username is not None and password is None:
        hint = f"name a file with the password as {section}.password_file, or pass the credential {credential}"
        raise ConfigurationError("there is a user name but no password", key=f"{section}.username", hint=hint)
    if username is None and password is not None:
        raise ConfigurationError(
            "there is a password but no user name", key=f"{section}.password_file", hint=f"set {section}.username"
        )


def _refusals(refused: dict[str, tuple[int, bytes]]) -> str:
    parts = (f"{address} ({code} {_said(text)})" for address, (code, text) in refused.items())
    return f"the server does not take mail for {', '.join(parts)}"


def _said(answer: bytes | str) -> str:
    return one_line(answer.decode(errors="replace") if isinstance(answer, bytes) else answer, _LONGEST_SUBJECT)
