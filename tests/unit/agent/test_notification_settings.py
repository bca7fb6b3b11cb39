"""Section `[notifications]`: what is refused at the border, with the key and the reason."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from receivers import Mailbox, free_port, mail_server, secret_file, web_receiver
from service_house import settings_document

from agent.cli.notify import notify_command
from agent.settings.notifications import ChannelSettings, MailSettings, MqttSettings, WebhookSettings
from agent.settings.schema import Settings, parse_settings
from drivers.errors import ConfigurationError
from twin.errors import FormatError
from twin.formats.toml_reading import validate_document

MAIL = {"host": "mail.plant.example", "sender": "volcal@plant.example", "to": ["ann@plant.example"]}
PAGE = Path(__file__).resolve().parents[3] / "docs" / "reference" / "settings.md"
MQTT = {"host": "broker.plant.example"}


def read(tmp_path: Path, **sections: Any) -> Settings:
    return validate_document(settings_document(tmp_path, notifications=sections), "volcal.toml", Settings)


def test_without_the_section_nobody_is_told(tmp_path) -> None:
    assert read(tmp_path).notifications.channels == {}


def test_ports_follow_from_the_encryption(tmp_path) -> None:
    found = read(tmp_path, mqtt=MQTT, mail=MAIL).notifications
    assert found.mqtt is not None
    assert found.mail is not None
    assert (found.mqtt.broker_port, found.mail.server_port) == (8883, 587)
    local = read(tmp_path, mqtt={"host": "localhost", "tls": False}, mail={**MAIL, "security": "tls"}).notifications
    assert local.mqtt is not None
    assert local.mail is not None
    assert (local.mqtt.broker_port, local.mail.server_port) == (1883, 465)


def test_paths_are_beside_the_settings_file(tmp_path) -> None:
    sections = {
        "mqtt": {**MQTT, "password_file": "a", "ca_file": "b"},
        "webhook": {"url": "https://hook.example/", "key_file": "c"},
        "mail": {**MAIL, "password_file": "/d"},
    }
    found = read(tmp_path, **sections).resolved(tmp_path).notifications
    assert found.mqtt is not None
    assert found.webhook is not None
    assert found.mail is not None
    assert (found.mqtt.password_file, found.mqtt.ca_file) == (tmp_path / "a", tmp_path / "b")
    assert (found.webhook.key_file, found.mail.password_file) == (tmp_path / "c", Path("/d"))
    assert found.webhook.ca_file is None


BAD_HOSTS = ["", "a b", "host:1883", "mqtt://host", "-x", "a..b", "x" * 300, "ho\nst", "user@host"]
BAD_URLS = [
    *("", "hook.example", "ftp://hook.example/", "https://", "https:///path", "https://hook.example:99999/"),
    *(
        "https://hook.example:0/",
        "https://hook.example/#part",
        "https://hook.example/a b",
        "https://hook.example/\r\nX: y",
    ),
    *("http://hook.example/", "https://exämple/", "https://[::1/", "//hook.example/"),
]
BAD_ADDRESSES = [
    "",
    "ann",
    "ann@",
    "@plant.example",
    "Ann <ann@plant.example>",
    "a@b@c",
    "ann@plant.example\nBcc: x@y",
    "a,b@c",
]


@pytest.mark.parametrize("host", BAD_HOSTS)
@pytest.mark.parametrize(("name", "section"), [("mqtt", MQTT), ("mail", MAIL)])
def test_a_host_is_a_name_or_an_address(tmp_path, name, section, host) -> None:
    with pytest.raises(FormatError) as refused:
        read(tmp_path, **{name: {**section, "host": host}})
    assert refused.value.where["key"] == f"notifications.{name}.host"


@pytest.mark.parametrize("url", BAD_URLS)
def test_a_url_is_one_of_a_receiver(tmp_path, url) -> None:
    with pytest.raises(FormatError) as refused:
        read(tmp_path, webhook={"url": url})
    assert refused.value.where["key"].startswith("notifications.webhook")


def test_a_password_in_a_url_is_refused_and_not_repeated(tmp_path) -> None:
    with pytest.raises(FormatError, match="must not contain a name or a password") as refused:
        read(tmp_path, webhook={"url": "https://volcal:pa55word@hook.example/"})
    assert "pa55word" not in str(refused.value)


@pytest.mark.parametrize("url", ["volcal:pa55word@hook/", "https:/volcal:pa55word@hook/", "https://volcal:pa55/word@h"])
def test_a_password_in_a_malformed_url_is_not_repeated(tmp_path, url) -> None:
    with pytest.raises(FormatError) as refused:
        read(tmp_path, webhook={"url": url})
    assert "pa55" not in str(refused.value)


@pytest.mark.parametrize("address", BAD_ADDRESSES)
@pytest.mark.parametrize("key", ["sender", "to"])
def test_a_mail_address_is_plain(tmp_path, key, address) -> None:
    with pytest.raises(FormatError) as refused:
        read(tmp_path, mail={**MAIL, key: address if key == "sender" else [address]})
    assert refused.value.where["key"].startswith(f"notifications.mail.{key}")


@pytest.mark.parametrize("topic", ["", "a/#", "+/b", "/a", "a/", "$SYS/a", "a\0b", "x" * 300])
def test_a_topic_is_one_to_publish_to(tmp_path, topic) -> None:
    with pytest.raises(FormatError):
        read(tmp_path, mqtt={**MQTT, "topic": topic})


@pytest.mark.parametrize(
    ("sections", "reason"),
    [
        ({"mqtt": {**MQTT, "tls": False}}, "tls may be false only for a broker on this computer"),
        ({"mail": {**MAIL, "security": "none"}}, "only for a server on this computer"),
        ({"webhook": {"url": "http://10.0.0.7/"}}, "must begin with https"),
        ({"mail": {**MAIL, "to": []}}, "at least 1"),
        ({"mail": {**MAIL, "password": "x"}}, "password"),
        ({"mqtt": {**MQTT, "port": 0}}, "greater than or equal to 1"),
        ({"mqtt": {**MQTT, "events": []}}, "at least 1"),
        ({"mqtt": {**MQTT, "events": ["ends"]}}, "ends"),
        ({"mqtt": {**MQTT, "timeout_s": 0.0}}, "timeout_s"),
        ({"language": "fr"}, "language"),
        ({"max_age_hours": 0.0}, "max_age_hours"),
    ],
)
def test_what_cannot_be_meant_is_refused(tmp_path, sections, reason) -> None:
    with pytest.raises(FormatError) as refused:
        read(tmp_path, **sections)
    assert reason in str(refused.value)


@pytest.mark.parametrize(
    ("heading", "models"),
    [
        ("the section of a receiver", (ChannelSettings,)),
        ("`[notifications.mqtt]`", (MqttSettings,)),
        ("`[notifications.webhook]`", (WebhookSettings,)),
        ("`[notifications.mail]`", (MailSettings,)),
    ],
)
def test_the_page_has_each_key_of_a_receiver_with_its_default(heading, models) -> None:
    (table,) = re.findall(rf"\n\| in {re.escape(heading)} \|[^\n]*\n\|[-|]+\n((?:\|[^\n]*\n)+)", PAGE.read_text())
    stated = dict(re.findall(r"^\| `(\w+)` \| `?(.+?)`? \|", table, re.MULTILINE))
    common = set(ChannelSettings.model_fields) if models != (ChannelSettings,) else set()
    fields = {name: field for model in models for name, field in model.model_fields.items() if name not in common}
    assert stated == {
        name: "required" if field.is_required() else json.dumps(field.default) for name, field in fields.items()
    }


# ---------------------------------------------------------------------- volcal notify


def config(tmp_path: Path, notifications: str) -> Path:
    document = settings_document(tmp_path / "state")
    lines = [f'{name} = "{document[name]}"' for name in ("machine", "artefact", "state_directory")]
    lines += ['devices.twin.driver = "simulated"', *(f'roles.{role} = "twin"' for role in document["roles"])]
    path = tmp_path / "volcal.toml"
    path.write_text("\n".join([*lines, "stations.places_mm = [[700.0, 1000.0, 750.0]]", notifications, ""]))
    parse_settings(path.read_text(), str(path))
    return path


def test_a_test_notice_goes_to_every_receiver(tmp_path) -> None:
    box, port = Mailbox(), free_port()
    with web_receiver() as receiver, mail_server(box, port):
        path = config(
            tmp_path,
            f'[notifications]\nlanguage = "de"\n[notifications.webhook]\nurl = "http://127.0.0.1:{receiver.port}/"\n'
            f'[notifications.mail]\nhost = "127.0.0.1"\nport = {port}\nsecurity = "none"\n'
            'sender = "volcal@plant.example"\nto = ["ann@plant.example"]',
        )
        result = CliRunner().invoke(notify_command, ["--config", str(path), "--json"])
        assert result.exit_code == 0, result.output
        assert '"webhook": {"taken": true, "problem": ""}' in result.stdout
        assert receiver.next().headers["Idempotency-Key"]
        _, mail = box.next()
        assert mail["Subject"].endswith("Test der Benachrichtigungen")
        receiver.answers.put(500)
        result = CliRunner().invoke(notify_command, ["--config", str(path), "--to", "webhook"])
    assert result.exit_code == 3
    assert "answers 500" in result.stdout
    assert box.mails.empty()


def test_a_receiver_without_its_secret_does_not_keep_another_from_being_tried(tmp_path) -> None:
    with web_receiver() as receiver:
        path = config(
            tmp_path,
            f'[notifications.webhook]\nurl = "http://127.0.0.1:{receiver.port}/"\n'
            '[notifications.mqtt]\nhost = "127.0.0.1"\nusername = "mill-3"',
        )
        result = CliRunner().invoke(notify_command, ["--config", str(path), "--to", "webhook"])
        assert result.exit_code == 0, result.output
        result = CliRunner().invoke(notify_command, ["--config", str(path)])
        assert result.exit_code == ConfigurationError.exit_code
    assert receiver.posts.qsize() == 1


@pytest.mark.parametrize("arguments", [[], ["--to", "mqtt"]])
def test_without_a_receiver_the_command_says_what_to_add(tmp_path, arguments) -> None:
    path = config(tmp_path, "")
    result = CliRunner().invoke(notify_command, ["--config", str(path), *arguments])
    assert result.exit_code == ConfigurationError.exit_code
    assert "the settings name no receiver" in result.stderr
    assert "[notifications.mqtt]" in result.stderr


def test_a_secret_that_others_can_read_is_named(tmp_path) -> None:
    secret_file(tmp_path).chmod(0o644)
    hook = '[notifications.webhook]\nurl = "https://hook.example/"\nkey_file = "secret"'
    result = CliRunner().invoke(notify_command, ["--config", str(config(tmp_path, hook))])
    assert result.exit_code == ConfigurationError.exit_code
    assert "notifications.webhook.key_file" in result.stderr
    assert "chmod 600" in result.stderr
