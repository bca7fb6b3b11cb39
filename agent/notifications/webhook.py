"""Delivery by HTTP: each notice is posted as JSON, signed if there is a key."""

from __future__ import annotations

import hashlib
import hmac
import json
import ssl
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from http.client import HTTPConnection, HTTPException
from urllib.parse import urlsplit

from agent.notifications.connection import DeliveryFailed, NoticeRefused, delivery, read_secret, tls_context
from agent.notifications.notice import Notice
from agent.settings.notifications import WebhookSettings

REFUSALS = frozenset({400, 409, 413, 414, 415, 422, 431})
"""Answers that are about the notice itself, not about the key, the URL or the time."""
KEY_CREDENTIAL = "webhook-key"
_SECTION = "notifications.webhook"


@dataclass(frozen=True)
class WebhookChannel:
    """HTTP receiver. Only an answer of 200 to 299 counts as taken; a redirection is not followed, since the signed
    notice would go to somebody else. `unix_time` returns the UTC time in s since 1970."""

    settings: WebhookSettings
    key: str | None = field(repr=False)
    tls: ssl.SSLContext | None
    unix_time: Callable[[], float] = time.time

    def send(self, notice: Notice) -> str:
        body = json.dumps(notice.as_json(), ensure_ascii=False).encode()
        parts, timeout_s = urlsplit(self.settings.url), self.settings.timeout_s
        host = parts.hostname or ""
        port = parts.port or (80 if self.tls is None else 443)
        with delivery(f"webhook on {host}", timeout_s, (HTTPException,)) as connections:
            connection = HTTPConnection(host, port)
            plain = connections.connect(host, port)
            connection.sock = plain if self.tls is None else self.tls.wrap_socket(plain, server_hostname=host)
            try:
                target = f"{parts.path or '/'}{'?' if parts.query else ''}{parts.query}"
                connection.request("POST", target, body, {"Host": parts.netloc, **self._headers(notice, body)})
                status = connection.getresponse().status
                if connections.expired:  # the shut connection ends an answer like a receiver that has said everything
                    raise TimeoutError
            finally:
                connection.close()
        if not 200 <= status <= 299:
            hint = "redirections are not followed; give the final URL" if 300 <= status <= 399 else ""
            failure = NoticeRefused if status in REFUSALS else DeliveryFailed
            raise failure(f"the receiver answers {status}", hint=hint, receiver=f"webhook on {host}")
        return ""

    def _headers(self, notice: Notice, body: bytes) -> dict[str, str]:
        headers = {"Content-Type": "application/json", "User-Agent": "volcal", "Idempotency-Key": notice.notice_id}
        if self.key is None:
            return headers
        stamp = str(int(self.unix_time()))
        signature = hmac.new(self.key.encode(), f"{stamp}.".encode() + body, hashlib.sha256).hexdigest()
        return {**headers, "X-Volcal-Timestamp": stamp, "X-Volcal-Signature": f"sha256={signature}"}


def webhook_channel(settings: WebhookSettings) -> WebhookChannel:
    """Return the channel of these settings. Raise ConfigurationError if a file that they name cannot be used."""
    key = read_secret(KEY_CREDENTIAL, settings.key_file, f"{_SECTION}.key_file")
    encrypted = urlsplit(settings.url).scheme == "https"
    return WebhookChannel(settings, key, tls_context(settings.ca_file, f"{_SECTION}.ca_file") if encrypted else None)
