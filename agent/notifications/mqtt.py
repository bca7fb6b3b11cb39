"""Delivery by MQTT 3.1.1: notices with quality of service 1, and the retained state of the machine."""

from __future__ import annotations

import json
import re
import socket
import ssl
from collections.abc import Callable
from dataclasses import dataclass, field

from paho.mqtt.client import MQTT_ERR_SUCCESS, CallbackAPIVersion, Client, ConnectFlags, error_string
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode

from agent.notifications.connection import BoundedConnections, DeliveryFailed, delivery, read_secret, tls_context
from agent.notifications.mail import require_both
from agent.notifications.notice import Notice
from agent.settings.notifications import MqttSettings

PASSWORD_CREDENTIAL = "mqtt-password"  # noqa: S105  the name of the credential
_SECTION = "notifications.mqtt"
_AT_LEAST_ONCE = 1
_LOOK_S = 0.1
_NO_TOPIC = re.compile(r"[/+#\x00-\x1f\x7f\s]+")


class _BoundedClient(Client):
    """MQTT client whose connection ends at the deadline of the delivery."""

    def __init__(self, connections: BoundedConnections, tls: ssl.SSLContext | None) -> None:
        # An empty identity lets the broker choose one: two deliveries of one machine must not end each other.
        super().__init__(CallbackAPIVersion.VERSION2, client_id="", clean_session=True, reconnect_on_failure=False)
        self._connections = connections
        self._tls = tls
        self.answer: ReasonCode | None = None
        self.on_connect = self._note_answer

    def _create_socket(self) -> socket.socket:
        """Return the connection. Unlike the method of the library, it leaves none open if TLS cannot be agreed."""
        plain = self._connections.connect(self._host, self._port)
        return plain if self._tls is None else self._tls.wrap_socket(plain, server_hostname=self._host)

    def _note_answer(
        self, client: Client, _userdata: object, flags: ConnectFlags, reason: ReasonCode, properties: Properties | None
    ) -> None:
        self.answer = reason


@dataclass(frozen=True)
class MqttChannel:
    """MQTT broker, to which a connection is made for each notice."""

    settings: MqttSettings
    password: str | None = field(repr=False)
    tls: ssl.SSLContext | None

    def send(self, notice: Notice) -> str:
        settings, receiver = self.settings, f"MQTT broker {self.settings.host}"
        retained = notice.occasion == "state"
        topic = f"{settings.topic}/{topic_level(notice.machine)}/{'state' if retained else 'notice'}"
        with delivery(receiver, settings.timeout_s, (ValueError, RuntimeError)) as connections:
            client = _BoundedClient(connections, self.tls)
            if settings.username is not None:
                client.username_pw_set(settings.username, self.password)
            try:
                client.connect(settings.host, settings.broker_port, keepalive=max(int(settings.timeout_s), 1))
                _loop_until(client, connections, lambda: client.answer is not None)
                if client.answer is not None and client.answer.is_failure:
                    raise DeliveryFailed(f"the broker refuses the connection: {client.answer}", receiver=receiver)
                payload = json.dumps(notice.as_json(), ensure_ascii=False)
                published = client.publish(topic, payload, _AT_LEAST_ONCE, retain=retained)
                _loop_until(client, connections, published.is_published)
                client.disconnect()
            finally:
                client._sock_close()
        return ""


def _loop_until(client: Client, connections: BoundedConnections, done: Callable[[], bool]) -> None:
    """Exchange packets with the broker until `done`. Raise OSError if the connection ends or the time is over first."""
    while not done():
        if connections.expired:
            raise TimeoutError
        result = client.loop(min(_LOOK_S, connections.remaining_s))
        if result != MQTT_ERR_SUCCESS and not done():
            raise ConnectionError(f"the connection ended: {error_string(result)}")


def topic_level(machine: str) -> str:
    """Return the name of a machine as a single level of a topic."""
    return _NO_TOPIC.sub("-", machine).strip("-") or "machine"


def mqtt_channel(settings: MqttSettings) -> MqttChannel:
    """Return the channel of these settings. Raise ConfigurationError if a file that they name cannot be used, or if
    there is a user name without a password."""
    password = read_secret(PASSWORD_CREDENTIAL, settings.password_file, f"{_SECTION}.password_file")
    require_both(settings.username, password, _SECTION, PASSWORD_CREDENTIAL)
    return MqttChannel(
        settings, password, tls_context(settings.ca_file, f"{_SECTION}.ca_file") if settings.tls else None
    )
