"""Notices by MQTT, HTTP and mail: with real receivers on loopback, and with peers that refuse, hang, drip and lie."""

from __future__ import annotations

import hashlib
import hmac
import json
import socket
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from receivers import (
    NAME,
    PASSWORD,
    PATIENCE_S,
    Mailbox,
    certificate,
    drip,
    drip_tls,
    floods,
    free_port,
    hang,
    mail_server,
    mosquitto,
    needs_mosquitto,
    notice,
    port_of_nobody,
    says,
    scripted,
    secret_file,
    shut,
    silent_address,
    subscribed,
    web_receiver,
)

from agent.notifications.connection import Channel, DeliveryFailed, NoticeRefused
from agent.notifications.mail import mail_channel
from agent.notifications.mqtt import mqtt_channel
from agent.notifications.notice import StoredNotice
from agent.notifications.webhook import webhook_channel
from agent.settings.notifications import MailSettings, MqttSettings, WebhookSettings
from drivers.errors import ConfigurationError

QUICK_S = 1.0
"""Time that a delivery to a bad receiver may take; a good one gets PATIENCE_S."""
SHARED_S = 20.0
"""Time of a delivery to a receiver with a bad and a good address: each gets half of it."""


def mqtt(port: int, timeout_s: float = PATIENCE_S, **chosen: Any) -> Channel:
    values = {"host": "127.0.0.1", "port": port, "tls": False, "timeout_s": timeout_s, **chosen}
    return mqtt_channel(MqttSettings.model_validate(values))


def webhook(port: int, timeout_s: float = PATIENCE_S, **chosen: Any) -> Channel:
    values = {"url": f"http://127.0.0.1:{port}/volcal?hall=2", "timeout_s": timeout_s, **chosen}
    return webhook_channel(WebhookSettings.model_validate(values))


def mail(port: int, timeout_s: float = PATIENCE_S, **chosen: Any) -> Channel:
    values = {"host": "127.0.0.1", "port": port, "security": "none", "timeout_s": timeout_s}
    values |= {"sender": "volcal@plant.example", "to": ["ann@plant.example", "bob@plant.example"]}
    return mail_channel(MailSettings.model_validate({**values, **chosen}))


# ---------------------------------------------------------------------- MQTT


@needs_mosquitto
def test_a_notice_reaches_the_subscribers_of_a_broker(tmp_path: Path) -> None:
    port = free_port()
    with mosquitto(tmp_path, port), subscribed(port, "plant/#") as messages:
        assert mqtt(port, topic="plant").send(notice()) == ""
        message = messages.get(timeout=PATIENCE_S)
    assert (message.topic, message.qos, message.retain) == ("plant/Fräse-3-Halle-2/notice", 1, False)
    assert StoredNotice.model_validate_json(message.payload).notice() == notice()


@needs_mosquitto
def test_the_latest_state_is_retained_and_notices_are_not(tmp_path: Path) -> None:
    port = free_port()
    with mosquitto(tmp_path, port):
        channel = mqtt(port)
        channel.send(notice("n-1"))
        for number, state in enumerate(("measuring", "complete")):
            channel.send(notice(f"s-{number}", occasion="state", state=state))
        with subscribed(port, "volcal/#") as messages:
            message = messages.get(timeout=PATIENCE_S)
            channel.send(notice("n-2"))
            following = messages.get(timeout=PATIENCE_S)
    assert (message.topic, message.retain) == ("volcal/Fräse-3-Halle-2/state", True)
    assert json.loads(message.payload)["state"] == "complete"
    assert json.loads(following.payload)["notice_id"] == "n-2"


@needs_mosquitto
def test_the_password_and_the_notice_go_over_tls(tmp_path: Path) -> None:
    port, tls = free_port(), certificate(tmp_path)
    chosen: dict[str, Any] = {
        "tls": True,
        "ca_file": tls.certificate,
        "username": NAME,
        "password_file": secret_file(tmp_path),
    }
    with mosquitto(tmp_path, port, tls), subscribed(port, "volcal/#", tls) as messages:
        mqtt(port, **chosen).send(notice())
        assert json.loads(messages.get(timeout=PATIENCE_S).payload)["notice_id"] == "n-1"
        wrong = secret_file(tmp_path, "another secret")
        with pytest.raises(DeliveryFailed, match=r"refuses the connection: .*[Nn]ot authorized") as refused:
            mqtt(port, **{**chosen, "password_file": wrong}).send(notice())
    assert "another secret" not in str(refused.value)


@needs_mosquitto
def test_a_broker_with_a_foreign_certificate_gets_no_password(tmp_path: Path) -> None:
    port, tls, other = free_port(), certificate(tmp_path), certificate(tmp_path, "other")
    chosen: dict[str, Any] = {"username": NAME, "password_file": secret_file(tmp_path), "ca_file": other.certificate}
    with mosquitto(tmp_path, port, tls), pytest.raises(DeliveryFailed, match="certificate of the receiver"):
        mqtt(port, tls=True, **chosen).send(notice())


# ---------------------------------------------------------------------- HTTP


def test_a_notice_is_posted_as_json_with_a_signature_over_time_and_body(tmp_path: Path) -> None:
    with web_receiver() as receiver:
        assert webhook(receiver.port, key_file=secret_file(tmp_path)).send(notice()) == ""
        posted = receiver.next()
    assert posted.path == "/volcal?hall=2"
    assert posted.headers["Host"] == f"127.0.0.1:{receiver.port}"
    assert posted.headers["Content-Type"] == "application/json"
    assert posted.headers["Idempotency-Key"] == "n-1"
    signed = posted.headers["X-Volcal-Timestamp"].encode() + b"." + posted.body
    expected = hmac.new(PASSWORD.encode(), signed, hashlib.sha256).hexdigest()
    assert posted.headers["X-Volcal-Signature"] == f"sha256={expected}"
    assert StoredNotice.model_validate_json(posted.body).notice() == notice()
    assert "Störung" in json.loads(posted.body)["subject"]


def test_without_a_key_nothing_is_signed() -> None:
    with web_receiver() as receiver:
        webhook(receiver.port).send(notice())
        assert "X-Volcal-Signature" not in receiver.next().headers


def test_https_is_checked_against_the_authority_and_the_name(tmp_path: Path) -> None:
    good, other = certificate(tmp_path), certificate(tmp_path, "other")
    elsewhere = certificate(tmp_path, "elsewhere", "127.0.0.9")
    with web_receiver(good) as receiver:
        url = f"https://127.0.0.1:{receiver.port}/volcal"
        webhook(receiver.port, url=url, ca_file=good.certificate).send(notice())
        assert receiver.next().path == "/volcal"
        for ca_file in (other.certificate, None):
            with pytest.raises(DeliveryFailed, match="certificate of the receiver"):
                webhook(receiver.port, url=url, ca_file=ca_file).send(notice())
    with web_receiver(elsewhere) as receiver:
        url = f"https://127.0.0.1:{receiver.port}/volcal"
        with pytest.raises(DeliveryFailed, match="certificate of the receiver"):
            webhook(receiver.port, url=url, ca_file=elsewhere.certificate).send(notice())
        assert receiver.posts.empty()


@pytest.mark.parametrize("code", [301, 307, 400, 401, 404, 413, 429, 500, 503])
def test_only_a_good_answer_counts_as_taken(code: int) -> None:
    with web_receiver() as receiver:
        receiver.answers.put(code)
        with pytest.raises(DeliveryFailed, match=f"answers {code}") as failed:
            webhook(receiver.port).send(notice())
    assert isinstance(failed.value, NoticeRefused) == (code in {400, 413})


@pytest.mark.parametrize(("answer", "of_the_notice"), [("554 5.7.1 spam", True), ("451 4.3.0 later", False)])
def test_a_mail_server_may_refuse_the_content(answer: str, of_the_notice: bool) -> None:
    class Picky(Mailbox):
        async def handle_DATA(self, server: Any, session: Any, envelope: Any) -> str:  # noqa: N802
            return answer

    port = free_port()
    with mail_server(Picky(), port), pytest.raises(DeliveryFailed, match=answer[4:]) as failed:
        mail(port).send(notice())
    assert isinstance(failed.value, NoticeRefused) == of_the_notice


# ---------------------------------------------------------------------- mail


def test_a_mail_says_it_in_words_to_all_recipients() -> None:
    box, port = Mailbox(), free_port()
    with mail_server(box, port):
        assert mail(port).send(notice()) == ""
    to, found = box.next()
    assert to == ["ann@plant.example", "bob@plant.example"]
    assert found["Subject"] == "Fräse 3: Nachtlauf: Störung"
    assert found["From"] == "volcal@plant.example"
    assert found["Message-ID"] == "<n-1@plant.example>"
    assert found["Date"].datetime.isoformat() == "2026-11-21T02:14:00+00:00"
    assert found["Priority"] == "urgent"
    assert found.get_content().replace("\r\n", "\n") == notice().text


def test_the_mail_server_is_greeted_with_an_address() -> None:
    """Many servers refuse a name without a domain."""
    greetings: list[str] = []

    class Box(Mailbox):
        async def handle_EHLO(  # noqa: N802
            self, server: Any, session: Any, envelope: Any, hostname: str, responses: list[str]
        ) -> list[str]:
            greetings.append(hostname)
            session.host_name = hostname
            return responses

    box, port = Box(), free_port()
    with mail_server(box, port):
        assert mail(port).send(notice()) == ""
    assert greetings == ["[127.0.0.1]"]


@pytest.mark.parametrize("from_start", [False, True])
def test_the_password_of_the_mail_server_goes_over_tls(tmp_path: Path, from_start: bool) -> None:
    box, port, tls = Mailbox(), free_port(), certificate(tmp_path)
    chosen: dict[str, Any] = {
        "security": "tls" if from_start else "starttls",
        "ca_file": tls.certificate,
        "username": NAME,
        "password_file": secret_file(tmp_path),
    }
    with mail_server(box, port, tls, from_start=from_start):
        mail(port, **chosen).send(notice())
        assert box.next()[1]["Message-ID"] == "<n-1@plant.example>"
        with pytest.raises(DeliveryFailed, match="answers 535") as refused:
            mail(port, **{**chosen, "password_file": secret_file(tmp_path, "another secret")}).send(notice())
    assert "another secret" not in str(refused.value)


def test_without_tls_nothing_is_sent(tmp_path: Path) -> None:
    """A server, or somebody between, that does not offer STARTTLS."""
    box, port = Mailbox(), free_port()
    with mail_server(box, port), pytest.raises(DeliveryFailed, match="STARTTLS"):
        mail(port, security="starttls", ca_file=certificate(tmp_path).certificate).send(notice())
    assert box.mails.empty()


def test_a_foreign_certificate_of_the_mail_server_is_refused(tmp_path: Path) -> None:
    box, port, other = Mailbox(), free_port(), certificate(tmp_path, "other")
    with (
        mail_server(box, port, certificate(tmp_path)),
        pytest.raises(DeliveryFailed, match="certificate of the receiver"),
    ):
        mail(port, security="starttls", ca_file=other.certificate).send(notice())


def test_a_refused_recipient_is_named_and_the_others_get_the_mail() -> None:
    box, port = Mailbox(unknown={"bob@plant.example"}), free_port()
    with mail_server(box, port):
        complaint = mail(port).send(notice())
        assert box.next()[0] == ["ann@plant.example"]
        box.unknown.add("ann@plant.example")
        with pytest.raises(DeliveryFailed, match=r"ann@plant\.example .*bob@plant\.example .550 5\.1\.1 no such user"):
            mail(port).send(notice())
    assert complaint == "the server does not take mail for bob@plant.example (550 5.1.1 no such user)"


def test_a_subject_cannot_add_headers() -> None:
    box, port = Mailbox(), free_port()
    with mail_server(box, port):
        mail(port).send(replace(notice(), subject="a\r\nBcc: eve@plant.example\r\n\r\nb\x1b[31m" + "x" * 5000))
    to, found = box.next()
    assert "eve@plant.example" not in to
    assert found["Bcc"] is None
    assert len(found["Subject"]) == 150


# ---------------------------------------------------------------------- bad receivers

CHANNELS: dict[str, Callable[..., Channel]] = {"mqtt": mqtt, "webhook": webhook, "mail": mail}


@pytest.mark.parametrize("script", [hang, drip, floods, shut, says(b"\x00\xff\r\n\r\n"), says(b"200 OK\r\n")])
@pytest.mark.parametrize("name", CHANNELS)
def test_a_bad_receiver_is_left_in_time(name: str, script: Any) -> None:
    with scripted(script) as port, pytest.raises(DeliveryFailed) as failed:
        CHANNELS[name](port, QUICK_S).send(notice())
    assert "127.0.0.1" in failed.value.where["receiver"]


@pytest.mark.parametrize("script", [hang, drip_tls, floods, shut])
@pytest.mark.parametrize("name", CHANNELS)
def test_a_tls_handshake_that_does_not_end_is_left_in_time(tmp_path: Path, name: str, script: Any) -> None:
    with scripted(script) as port, pytest.raises(DeliveryFailed):
        chosen: dict[str, dict[str, Any]] = {
            "mqtt": {"tls": True},
            "webhook": {"url": f"https://127.0.0.1:{port}/"},
            "mail": {"security": "tls"},
        }
        CHANNELS[name](port, QUICK_S, ca_file=certificate(tmp_path).certificate, **chosen[name]).send(notice())


@pytest.mark.parametrize("name", CHANNELS)
def test_a_receiver_that_is_away_cannot_be_reached(name: str) -> None:
    with port_of_nobody() as port, pytest.raises(DeliveryFailed, match="cannot be reached: connection refused"):
        CHANNELS[name](port).send(notice())


@pytest.mark.parametrize("name", CHANNELS)
def test_a_name_that_does_not_exist_cannot_be_reached(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown(*_: object, **__: object) -> None:
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    monkeypatch.setattr(socket, "getaddrinfo", unknown)
    chosen: dict[str, dict[str, Any]] = {
        "mqtt": {"host": "receiver.example", "tls": True},
        "webhook": {"url": "https://receiver.example/"},
        "mail": {"host": "receiver.example", "security": "starttls"},
    }
    with pytest.raises(DeliveryFailed, match="cannot be reached: the name of the host is not known") as failed:
        CHANNELS[name](1, **chosen[name]).send(notice())
    assert "receiver.example" in failed.value.where["receiver"]


def test_an_address_of_the_receiver_that_does_not_answer_leaves_time_for_the_next(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with silent_address() as silent, web_receiver() as receiver:
        addresses = [(socket.AF_INET, socket.SOCK_STREAM, 6, "", one) for one in (silent, ("127.0.0.1", receiver.port))]
        monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: addresses)
        assert webhook(receiver.port, SHARED_S).send(notice()) == ""
        assert receiver.posts.qsize() == 1


@pytest.mark.parametrize("name", CHANNELS)
def test_no_address_of_the_receiver_answers(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with silent_address() as silent:
        addresses = [(socket.AF_INET, socket.SOCK_STREAM, 6, "", silent)] * 2
        monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: addresses)
        with pytest.raises(DeliveryFailed, match="no complete answer within 1 s"):
            CHANNELS[name](1, QUICK_S).send(notice())


@pytest.mark.parametrize(
    "answer",
    [
        pytest.param(b"\x20\x02\x00\x00\x40\x02\x00\x07", id="an acknowledgement of something else"),
        pytest.param(b"\x20\x02\x00\x05", id="not authorised"),
        pytest.param(b"\x20\x02\x00\xee", id="a code that does not exist"),
        pytest.param(b"\x20\xff\xff\xff\xff\x7f", id="a length that does not exist"),
        pytest.param(b"\x30\xff\xff\xff\x7f", id="a message of 256 MB"),
    ],
)
def test_a_broker_that_lies_has_taken_nothing(answer: bytes) -> None:
    with scripted(says(answer)) as port, pytest.raises(DeliveryFailed):
        mqtt(port, QUICK_S).send(notice())


@pytest.mark.parametrize(
    "answer",
    [
        b"HTTP/1.1 200 OK",
        b"HTTP/1.1 100 Continue\r\n\r\n",
        b"HTTP/9.9 abc\r\n\r\n",
        b"HTTP/1.1 200 OK\r\n" + b"a: b\r\n" * 200,
    ],
)
def test_a_web_server_that_lies_has_taken_nothing(answer: bytes) -> None:
    with scripted(says(answer)) as port, pytest.raises(DeliveryFailed):
        webhook(port, QUICK_S).send(notice())


@pytest.mark.parametrize("answer", [b"421 busy\r\n", b"554 go away\r\n", b"220-" + b"x" * 20000, b"220-a\r\n" * 50])
def test_a_mail_server_that_lies_has_taken_nothing(answer: bytes) -> None:
    with scripted(says(answer)) as port, pytest.raises(DeliveryFailed):
        mail(port, QUICK_S).send(notice())


# ---------------------------------------------------------------------- files


def test_a_secret_that_others_can_read_is_refused(tmp_path: Path) -> None:
    path = secret_file(tmp_path)
    path.chmod(0o640)
    with pytest.raises(ConfigurationError, match="can be read by others") as refused:
        webhook(1, key_file=path)
    assert refused.value.where == {"key": "notifications.webhook.key_file", "file": str(path)}


@pytest.mark.parametrize("text", ["", "two\nlines"])
def test_a_secret_is_one_line(tmp_path: Path, text: str) -> None:
    with pytest.raises(ConfigurationError, match="does not contain one line"):
        webhook(1, key_file=secret_file(tmp_path, text))


def test_a_credential_of_systemd_comes_before_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "credentials").mkdir()
    (tmp_path / "credentials" / "webhook-key").write_text("of systemd")
    (tmp_path / "credentials" / "webhook-key").chmod(0o400)
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(tmp_path / "credentials"))
    with web_receiver() as receiver:
        webhook(receiver.port, key_file=secret_file(tmp_path)).send(notice())
        posted = receiver.next()
    signed = posted.headers["X-Volcal-Timestamp"].encode() + b"." + posted.body
    assert hmac.new(b"of systemd", signed, hashlib.sha256).hexdigest() in posted.headers["X-Volcal-Signature"]


@pytest.mark.parametrize("name", ["mqtt", "mail"])
def test_a_name_without_a_password_and_the_reverse_are_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(ConfigurationError, match="user name but no password"):
        CHANNELS[name](1, username=NAME)
    with pytest.raises(ConfigurationError, match="password but no user name"):
        CHANNELS[name](1, password_file=secret_file(tmp_path))


def test_an_authority_file_without_a_certificate_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "ca.pem"
    for text, reason in ((None, "no such file"), ("nothing", "no certificate")):
        if text is not None:
            path.write_text(text)
        with pytest.raises(ConfigurationError, match=reason):
            mail(1, security="tls", ca_file=path)


def test_a_channel_does_not_show_its_secret(tmp_path: Path) -> None:
    path = secret_file(tmp_path)
    for channel in (
        mqtt(1, username=NAME, password_file=path),
        mail(1, username=NAME, password_file=path),
        webhook(1, key_file=path),
    ):
        assert PASSWORD not in repr(channel)


def test_a_mail_is_taken_though_the_server_ends_without_a_farewell() -> None:
    """The farewell after the mail is a courtesy: an error there must not send the mail again."""

    class Rude(Mailbox):
        async def handle_QUIT(self, server: Any, session: Any, envelope: Any) -> str:  # noqa: N802
            return "421 4.3.0 no"

    box, port = Rude(), free_port()
    with mail_server(box, port):
        assert mail(port).send(notice()) == ""
    assert box.next()[1]["Message-ID"] == "<n-1@plant.example>"
