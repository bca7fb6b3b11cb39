"""Channels of the settings."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from agent.notifications.connection import Channel
from agent.notifications.dispatcher import Courier, Dispatcher, ReceiverState
from agent.notifications.outbox import Outbox
from agent.settings.notifications import NotificationSettings

FOLDER = "notifications"
"""Folder of the outbox in the state directory."""


def open_channels(settings: NotificationSettings) -> dict[str, Channel]:
    """Return the channels of the settings by name. Raise ConfigurationError if a file that they name cannot be used.

    The library of a channel is imported only if the channel is used.
    """
    found: dict[str, Channel] = {}
    if settings.mqtt is not None:
        from agent.notifications.mqtt import mqtt_channel  # noqa: PLC0415

        found["mqtt"] = mqtt_channel(settings.mqtt)
    if settings.webhook is not None:
        from agent.notifications.webhook import webhook_channel  # noqa: PLC0415

        found["webhook"] = webhook_channel(settings.webhook)
    if settings.mail is not None:
        from agent.notifications.mail import mail_channel  # noqa: PLC0415

        found["mail"] = mail_channel(settings.mail)
    return found


def dispatcher_of(
    settings: NotificationSettings,
    state_directory: Path,
    changed: Callable[[ReceiverState], object],
    note: Callable[[str], object],
) -> Dispatcher:
    """Return the dispatcher of these settings, whose outbox is in the state directory. See `Courier` for `changed` and
    `note`. Raise ConfigurationError if a file that the settings name cannot be used."""
    channels = open_channels(settings)
    outbox = Outbox(state_directory / FOLDER, channels)
    couriers = {
        name: Courier(name, channel, outbox, settings.max_age_hours, changed, note)
        for name, channel in channels.items()
    }
    return Dispatcher(outbox, couriers)
