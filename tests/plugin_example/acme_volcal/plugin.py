"""Entry point of the plugin: its settings, and the creation of a device from them."""

from __future__ import annotations

from pydantic import Field

from acme_volcal.device import AcmeCnc
from drivers.options import DriverOptions
from drivers.registry import DeviceContext, DriverPlugin


class AcmeSettings(DriverOptions):
    """Options of `driver = "acme-cnc"`. Unknown keys are refused, so that misspellings are reported."""

    host: str = Field(min_length=1)
    port: int = Field(default=7000, ge=1, le=65535)
    timeout_s: float = Field(default=1.0, gt=0.0, le=10.0)


def create(settings: AcmeSettings, context: DeviceContext) -> AcmeCnc:
    return AcmeCnc((settings.host, settings.port), settings.timeout_s, context.clock, context.name)


PLUGIN = DriverPlugin(
    "acme-cnc",
    AcmeSettings,
    create,
    claims=lambda settings: {f"ACME controller {settings.host}:{settings.port}": "port"},
)
