"""Receivers of notices on loopback: the mosquitto broker, the mail server aiosmtpd, an HTTP server, and peers that play
any script byte by byte."""

from __future__ import annotations

import shutil
import socket
import ssl
import subprocess
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from email.message import EmailMessage, Message
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from ipaddress import ip_address
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import paho.mqtt.client as mqtt
import pytest
from aiosmtpd.controller import Controller
from aiosmtpd.smtp import AuthResult, LoginPassword
from aloud import NOT_HERE
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import NameOID

from agent.notifications.notice import Notice, NoticeAlarm, NoticeRun

PATIENCE_S = 300.0
NAME, PASSWORD = "volcal", "a secret of the plant"
MOSQUITTO = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin")
needs_mosquitto = pytest.mark.skipif(MOSQUITTO is None, reason=f"{NOT_HERE}: notices by MQTT: mosquitto is missing")


def notice(notice_id: str = "n-1", **changed: Any) -> Notice:
    """A fault of a night, with letters that ASCII does not have."""
    alarm = NoticeAlarm(311, "Verbindung unterbrochen", "Kabel prüfen.", "no answer", "plug it in", {"device": "cnc"})
    run = NoticeRun("20261121T020000Z-0000", "nightly", verdict="faulted", machine_minutes=12.5, ve_um=31.25)
    values: dict[str, Any] = {
        "notice_id": notice_id,
        "at": "2026-11-21T02:14:00.000Z",
        "machine": "Fräse 3/Halle+2",
        "occasion": "end",
        "severity": "alarm",
        "state": "faulted",
        "subject": "Fräse 3: Nachtlauf: Störung",
        "text": "Ein Fehler hat den Lauf beendet.\nVE ohne Tabelle: 31,25 µm\n",
        "alarms": (alarm,),
        "run": run,
    }
    return Notice(**{**values, **changed})


def free_port() -> int:
    """Port for a server of ours, which no other process is given before the tests end."""
    holding = socket.socket()
    holding.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    holding.bind(("127.0.0.1", 0))
    port = int(holding.getsockname()[1])
    holding.detach()  # bound until the process ends
    return port


@contextmanager
def port_of_nobody() -> Iterator[int]:
    """Port at which nobody listens and that no other process is given meanwhile; a server of ours may bind it."""
    with socket.socket() as holding:
        holding.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        holding.bind(("127.0.0.1", 0))
        yield int(holding.getsockname()[1])


@contextmanager
def silent_address() -> Iterator[tuple[str, int]]:
    """Address that answers no attempt to connect, as behind a firewall: its queue of connections is full."""
    with socket.create_server(("127.0.0.1", 0), backlog=0) as listening, ExitStack() as waiting:
        for _ in range(3):
            one = waiting.enter_context(socket.socket())
            one.setblocking(False)
            with suppress(BlockingIOError):
                one.connect(listening.getsockname())
        yield listening.getsockname()


@dataclass(frozen=True)
class Certificate:
    """Self-signed certificate of 127.0.0.1, which is its own authority."""

    certificate: Path
    key: Path

    def context(self) -> ssl.SSLContext:
        context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
        context.load_cert_chain(self.certificate, self.key)
        return context


def certificate(directory: Path, name: str = "receiver", address: str = "127.0.0.1") -> Certificate:
    key = ec.generate_private_key(ec.SECP256R1())
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    now = datetime.now(UTC)
    builder = x509.CertificateBuilder(subject, subject, key.public_key(), x509.random_serial_number())
    dated = builder.not_valid_before(now - timedelta(days=1)).not_valid_after(now + timedelta(days=1))
    named = dated.add_extension(x509.SubjectAlternativeName([x509.IPAddress(ip_address(address))]), critical=False)
    authority = named.add_extension(x509.BasicConstraints(ca=True, path_length=None), critical=True)
    found = Certificate(directory / f"{name}.pem", directory / f"{name}.key")
    found.certificate.write_bytes(authority.sign(key, hashes.SHA256()).public_bytes(Encoding.PEM))
    found.key.write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    return found


def secret_file(directory: Path, text: str = PASSWORD) -> Path:
    path = directory / "secret"
    path.write_text(f"{text}\n")
    path.chmod(0o600)
    return path


# ---------------------------------------------------------------------- MQTT


@contextmanager
def mosquitto(directory: Path, port: int, tls: Certificate | None = None) -> Iterator[subprocess.Popen[bytes]]:
    """The broker, with a password if it has a certificate."""
    assert MOSQUITTO is not None
    lines = ["user root", f"listener {port} 127.0.0.1", "persistence false"]
    if tls is None:
        lines.append("allow_anonymous true")
    else:
        passwords = directory / "passwords"
        subprocess.run(["mosquitto_passwd", "-b", "-c", str(passwords), NAME, PASSWORD], check=True, timeout=PATIENCE_S)
        lines += ["allow_anonymous false", f"password_file {passwords}"]
        lines += [f"certfile {tls.certificate}", f"keyfile {tls.key}"]
    config = directory / "mosquitto.conf"
    config.write_text("\n".join([*lines, ""]))
    with (directory / "mosquitto.log").open("ab") as log:
        broker = subprocess.Popen([MOSQUITTO, "-c", str(config)], stdout=log, stderr=subprocess.STDOUT)
    try:
        while True:
            assert broker.poll() is None, (directory / "mosquitto.log").read_text()
            with suppress(OSError):
                socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S).close()
                break
        yield broker
    finally:
        broker.kill()
        broker.wait(PATIENCE_S)


@contextmanager
def subscribed(port: int, topic: str, tls: Certificate | None = None) -> Iterator[SimpleQueue[mqtt.MQTTMessage]]:
    """Messages of a topic as another client gets them, from the moment when the broker has confirmed it."""
    found: SimpleQueue[mqtt.MQTTMessage] = SimpleQueue()
    confirmed = threading.Event()
    client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2)
    if tls is not None:
        client.username_pw_set(NAME, PASSWORD)
        client.tls_set_context(ssl.create_default_context(cafile=tls.certificate))
    client.on_message = lambda _client, _data, message: found.put(message)
    client.on_subscribe = lambda *_: confirmed.set()
    client.connect("127.0.0.1", port, keepalive=600)
    client.subscribe(topic, qos=1)
    client.loop_start()
    try:
        assert confirmed.wait(PATIENCE_S)
        yield found
    finally:
        client.disconnect()
        client.loop_stop()


# ---------------------------------------------------------------------- mail


@dataclass
class Mailbox:
    """Mails that a server has taken. It refuses the recipients in `unknown`."""

    mails: SimpleQueue[tuple[list[str], Message]] = field(default_factory=SimpleQueue)
    unknown: set[str] = field(default_factory=set)

    async def handle_RCPT(self, server: Any, session: Any, envelope: Any, address: str, options: list[str]) -> str:  # noqa: N802
        if address in self.unknown:
            return "550 5.1.1 no such user"
        envelope.rcpt_tos.append(address)
        return "250 OK"

    async def handle_DATA(self, server: Any, session: Any, envelope: Any) -> str:  # noqa: N802
        from email import message_from_bytes, policy

        self.mails.put((list(envelope.rcpt_tos), message_from_bytes(envelope.content, policy=policy.default)))
        return "250 OK"

    def next(self) -> tuple[list[str], EmailMessage]:
        to, mail = self.mails.get(timeout=PATIENCE_S)
        assert isinstance(mail, EmailMessage)
        return to, mail


@contextmanager
def mail_server(box: Mailbox, port: int, tls: Certificate | None = None, *, from_start: bool = False) -> Iterator[None]:
    """The server; with a certificate it asks for TLS and for the password."""
    options: dict[str, Any] = {}
    if tls is not None:
        options |= {"authenticator": _authenticated, "auth_required": not from_start}  # it knows of no other TLS
        options |= {"ssl_context": tls.context()} if from_start else {"tls_context": tls.context()}
        options |= {"auth_require_tls": False} if from_start else {"require_starttls": True}
    controller = Controller(box, hostname="127.0.0.1", port=port, ready_timeout=PATIENCE_S, **options)
    controller.start()
    try:
        yield
    finally:
        controller.stop()


def _authenticated(server: Any, session: Any, envelope: Any, _mechanism: str, data: Any) -> AuthResult:
    good = isinstance(data, LoginPassword) and (data.login, data.password) == (NAME.encode(), PASSWORD.encode())
    return AuthResult(success=good, handled=False)


# ---------------------------------------------------------------------- HTTP


@dataclass(frozen=True)
class Posted:
    path: str
    headers: dict[str, str]
    body: bytes


@dataclass
class WebReceiver:
    """What was posted; the answers are the codes in `answers`, then 204."""

    posts: SimpleQueue[Posted] = field(default_factory=SimpleQueue)
    answers: SimpleQueue[int] = field(default_factory=SimpleQueue)
    port: int = 0

    def next(self) -> Posted:
        return self.posts.get(timeout=PATIENCE_S)


@contextmanager
def web_receiver(tls: Certificate | None = None, port: int = 0) -> Iterator[WebReceiver]:
    found = WebReceiver()

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"]))
            code = 204 if found.answers.empty() else found.answers.get()
            found.posts.put(Posted(self.path, dict(self.headers.items()), body))
            self.send_response(code)
            if code in (301, 307):
                self.send_header("Location", "http://127.0.0.1:9/elsewhere")
            self.send_header("Content-Length", "0")
            self.end_headers()

        def log_message(self, format: str, *args: Any) -> None:  # noqa: A002
            """Nothing is logged."""

    server = ThreadingHTTPServer(("127.0.0.1", port), Handler)
    server.handle_error = lambda *_: None  # type: ignore[method-assign]  # a client that refuses the certificate
    if tls is not None:
        server.socket = tls.context().wrap_socket(server.socket, server_side=True)
    found.port = server.server_address[1]
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield found
    finally:
        server.shutdown()
        server.server_close()
        thread.join(PATIENCE_S)


# ---------------------------------------------------------------------- any bytes


@contextmanager
def scripted(script: Callable[[socket.socket, threading.Event], object]) -> Iterator[int]:
    """Port of a peer that plays `script` on each connection, until the event that the script gets is set."""
    over = threading.Event()
    listening = socket.create_server(("127.0.0.1", 0))

    def play(connection: socket.socket) -> None:
        with connection, suppress(OSError):
            script(connection, over)

    def serve() -> None:
        with suppress(OSError):
            while True:
                connection, _ = listening.accept()
                threading.Thread(target=play, args=(connection,), daemon=True).start()

    accepting = threading.Thread(target=serve, daemon=True)
    accepting.start()
    try:
        yield int(listening.getsockname()[1])
    finally:
        over.set()
        listening.shutdown(socket.SHUT_RDWR)
        listening.close()
        accepting.join(PATIENCE_S)


def hang(connection: socket.socket, over: threading.Event) -> None:
    """Take everything and say nothing."""
    over.wait(PATIENCE_S)


def drip(connection: socket.socket, over: threading.Event) -> None:
    """Send a byte now and then, so that no silence is ever long."""
    while not over.wait(0.05):
        connection.sendall(b"2")


def drip_tls(connection: socket.socket, over: threading.Event) -> None:
    """Announce a long record of a TLS handshake and send it byte by byte."""
    connection.sendall(b"\x16\x03\x03\x3f\xff")
    while not over.wait(0.05):
        connection.sendall(b"\x02")


def shut(connection: socket.socket, over: threading.Event) -> None:
    """Close at once."""


def says(first: bytes) -> Callable[[socket.socket, threading.Event], None]:
    def script(connection: socket.socket, over: threading.Event) -> None:
        connection.sendall(first)
        over.wait(PATIENCE_S)

    return script


def floods(connection: socket.socket, over: threading.Event) -> None:
    """Send without end."""
    while not over.is_set():
        connection.sendall(b"\xff" * 4096)
