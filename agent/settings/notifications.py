"""Section `[notifications]` of the settings file: the receivers that are told about alarms and the ends of runs."""

from __future__ import annotations

import re
from ipaddress import ip_address
from pathlib import Path
from typing import Annotated, Literal, Self
from urllib.parse import urlsplit

from pydantic import AfterValidator, Field, PositiveFloat, model_validator

from twin.formats.toml_reading import StrictModel

_HOST_NAME = re.compile(r"(?=.{1,253}$)[A-Za-z0-9_]([A-Za-z0-9_-]{0,62})(\.[A-Za-z0-9_]([A-Za-z0-9_-]{0,62}))*\.?")
_MAIL_ADDRESS = re.compile(r"[A-Za-z0-9.!#$%&'*+/=?^_`{|}~-]{1,64}@(?P<host>[A-Za-z0-9.-]{1,253}|\[[0-9A-Fa-f.:]+\])")
_TOPIC = re.compile(r"[^+#\x00-\x1f\x7f]{1,200}")


def _host(text: str) -> str:
    try:
        return str(ip_address(text))
    except ValueError:
        pass
    if _HOST_NAME.fullmatch(text) is None:
        raise ValueError(f"must be a host name or an IP address without a port, found {text!r}")
    return text


def _mail_address(text: str) -> str:
    if _MAIL_ADDRESS.fullmatch(text) is None:
        raise ValueError(f"must be a plain mail address such as tooling@plant.example, found {text!r}")
    return text


def _topic(text: str) -> str:
    if _TOPIC.fullmatch(text) is None or text.startswith(("/", "$")) or text.endswith("/"):
        raise ValueError(f"must be a topic such as plant/hall-2, without + and #, found {text!r}")
    return text


def _url(text: str) -> str:
    """Return `text` if it is the URL of a receiver. A URL that may hold a password is not repeated in the error."""
    if not text.isascii() or not text.isprintable() or " " in text:
        raise ValueError("must be a URL of printable ASCII characters without blanks")
    try:
        parts = urlsplit(text)
        port = parts.port
    except ValueError:
        raise ValueError("must be a URL such as https://host/path, with a port from 1 to 65535 if any") from None
    if "@" in parts.netloc:
        raise ValueError("must not contain a name or a password, because settings are not secret")
    if parts.scheme not in ("http", "https") or not parts.hostname or port == 0 or parts.fragment:
        found = "" if "@" in text else f", found {text!r}"
        raise ValueError(f"must be a URL such as https://host/path, without a fragment{found}")
    _host(parts.hostname)
    return text


def is_loopback(host: str) -> bool:
    """Return True if `host` is this computer, so that nothing that is sent to it leaves the computer."""
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


Host = Annotated[str, AfterValidator(_host)]
MailAddress = Annotated[str, AfterValidator(_mail_address)]
Topic = Annotated[str, AfterValidator(_topic)]
ReceiverUrl = Annotated[str, AfterValidator(_url)]
Told = Literal["alarm", "end", "question", "not-started", "started"]
_TOLD: list[Told] = ["alarm", "end", "question", "not-started"]


class ChannelSettings(StrictModel):
    """Settings that every channel has.

    `events` are the occasions that are told: an alarm between runs, the end of a run, an open question of a run, a
    request of the timer that was not carried out, and the start of a run. One delivery ends after `timeout_s`. If
    `ca_file` is given, the certificate of the receiver is checked with it instead of the system's authorities.
    """

    events: list[Told] = Field(default=_TOLD, min_length=1)
    timeout_s: PositiveFloat = Field(default=20.0, ge=1.0, le=300.0)
    ca_file: Path | None = None

    def resolved(self, base: Path, *names: str) -> Self:
        """Return these settings with the paths `names` and `ca_file` resolved against the directory `base`."""
        paths = {name: getattr(self, name) for name in (*names, "ca_file")}
        return self.model_copy(update={name: (base / path).resolve() for name, path in paths.items() if path})


class MqttSettings(ChannelSettings):
    """Settings of the MQTT broker. Notices are published to ``TOPIC/MACHINE/notice``, and the latest state of the
    machine is retained at ``TOPIC/MACHINE/state``.

    The password is the credential ``mqtt-password`` of systemd or the content of `password_file`. It is sent only over
    TLS or to this computer.
    """

    host: Host
    port: int | None = Field(default=None, ge=1, le=65535)
    tls: bool = True
    topic: Topic = "volcal"
    username: str | None = Field(default=None, min_length=1, max_length=200)
    password_file: Path | None = None

    @property
    def broker_port(self) -> int:
        return self.port or (8883 if self.tls else 1883)

    @model_validator(mode="after")
    def _encrypted_unless_on_this_computer(self) -> Self:
        if not self.tls and not is_loopback(self.host):
            raise ValueError("notifications.mqtt.tls may be false only for a broker on this computer")
        return self


class WebhookSettings(ChannelSettings):
    """Settings of the HTTP receiver, to which every notice is posted as JSON.

    The key of the signature is the credential ``webhook-key`` of systemd or the content of `key_file`; without one the
    notices are not signed.
    """

    url: ReceiverUrl
    key_file: Path | None = None

    @model_validator(mode="after")
    def _encrypted_unless_on_this_computer(self) -> Self:
        parts = urlsplit(self.url)
        if parts.scheme != "https" and not is_loopback(parts.hostname or ""):
            raise ValueError("notifications.webhook.url must begin with https:// unless the receiver is this computer")
        return self


class MailSettings(ChannelSettings):
    """Settings of the mail server. `security` is the encryption: a TLS connection that begins without TLS
    (``starttls``), TLS from the start (``tls``), or ``none``, which is possible only for a server on this computer.

    The password is the credential ``mail-password`` of systemd or the content of `password_file`.
    """

    host: Host
    port: int | None = Field(default=None, ge=1, le=65535)
    security: Literal["starttls", "tls", "none"] = "starttls"
    sender: MailAddress
    to: list[MailAddress] = Field(min_length=1, max_length=20)
    username: str | None = Field(default=None, min_length=1, max_length=200)
    password_file: Path | None = None

    @property
    def server_port(self) -> int:
        return self.port or {"starttls": 587, "tls": 465, "none": 25}[self.security]

    @model_validator(mode="after")
    def _encrypted_unless_on_this_computer(self) -> Self:
        if self.security == "none" and not is_loopback(self.host):
            raise ValueError("notifications.mail.security may be 'none' only for a server on this computer")
        return self


class NotificationSettings(StrictModel):
    """Settings of the notifications. A receiver is used if its section exists.

    `language` is that of the mails and of the text in the notices. A notice that cannot be delivered is dropped after
    `max_age_hours`. `page_url` is the address under which a reader of the notice reaches the page of the service; the
    links to reports begin with it.
    """

    language: Literal["en", "de"] = "en"
    max_age_hours: PositiveFloat = Field(default=72.0, le=720.0)
    page_url: ReceiverUrl | None = None
    mqtt: MqttSettings | None = None
    webhook: WebhookSettings | None = None
    mail: MailSettings | None = None

    @property
    def channels(self) -> dict[str, ChannelSettings]:
        """Settings of the channels that are used, by name."""
        found = {"mqtt": self.mqtt, "webhook": self.webhook, "mail": self.mail}
        return {name: channel for name, channel in found.items() if channel is not None}

    def resolved(self, base: Path) -> Self:
        """Return these settings with relative paths resolved against the directory `base`."""
        return self.model_copy(
            update={
                "mqtt": self.mqtt and self.mqtt.resolved(base, "password_file"),
                "webhook": self.webhook and self.webhook.resolved(base, "key_file"),
                "mail": self.mail and self.mail.resolved(base, "password_file"),
            }
        )
