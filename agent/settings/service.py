"""Section `[service]` of the settings file: network access, permitted hours of unattended starts, and timeouts."""

from __future__ import annotations

from ipaddress import ip_address
from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, PositiveFloat, model_validator

from twin.formats.toml_reading import StrictModel

HourSpan = Annotated[str, Field(pattern=r"^([01]\d|2[0-3]):[0-5]\d-([01]\d|2[0-3]):[0-5]\d$")]


class ServiceSettings(StrictModel):
    """Settings of the service. `host` is the listening address; any address except loopback requires a certificate.

    An unattended start is permitted only within `hours` (local time, for example 22:00-05:30). This computer must also
    have been on for at least `warm_up_minutes`. If `idle_read_period_s` is not 0, the devices are asked once per this
    period between runs, without moving, resetting or writing anything; a device of which this cannot be said is not
    opened.
    """

    host: str = "127.0.0.1"
    port: int = Field(default=8517, ge=0, le=65535)
    host_names: list[str] = Field(default=[])
    certificate_file: Path | None = None
    key_file: Path | None = None
    token_file: Path | None = None
    warm_up_minutes: float = Field(default=30.0, ge=0.0, le=1440.0)
    hours: list[HourSpan] = Field(default=[])
    answer_timeout_minutes: PositiveFloat = Field(default=120.0, le=1440.0)
    hang_timeout_s: float = Field(default=30.0, ge=5.0, le=600.0)
    computation_timeout_minutes: PositiveFloat = Field(default=15.0, le=240.0)
    stop_timeout_s: float = Field(default=60.0, ge=5.0, le=600.0)
    idle_read_period_s: float = Field(default=10.0, ge=0.0, le=3600.0)

    @property
    def loopback(self) -> bool:
        return self.host == "localhost" or ip_address(self.host).is_loopback

    @property
    def reached_at(self) -> str:
        """Host part of the URL under which this computer reaches the service."""
        if self.host != "localhost" and ip_address(self.host).is_unspecified:
            return "[::1]" if ":" in self.host else "127.0.0.1"
        return f"[{self.host}]" if ":" in self.host else self.host

    @property
    def scheme(self) -> str:
        return "http" if self.certificate_file is None else "https"

    @model_validator(mode="after")
    def _idle_period_is_off_or_a_second(self) -> Self:
        if 0.0 < self.idle_read_period_s < 1.0:
            raise ValueError(
                f"service.idle_read_period_s must be 0 (off) or at least 1 s, found {self.idle_read_period_s:g}: the "
                "devices would be opened all the time"
            )
        return self

    @model_validator(mode="after")
    def _open_only_with_a_certificate(self) -> Self:
        if self.host != "localhost":
            try:
                ip_address(self.host)
            except ValueError:
                raise ValueError(f"service.host must be an IP address or 'localhost', found {self.host!r}") from None
        if (self.certificate_file is None) is not (self.key_file is None):
            raise ValueError("service.certificate_file and service.key_file must be given together")
        if not self.loopback and self.certificate_file is None:
            raise ValueError(
                "service.host is not loopback, so service.certificate_file and service.key_file are required: "
                "the token must not be sent unencrypted"
            )
        return self

    def resolved(self, base: Path) -> ServiceSettings:
        """Return these settings with relative paths resolved against the directory `base`."""
        named = {name: getattr(self, name) for name in ("certificate_file", "key_file", "token_file")}
        return self.model_copy(
            update={name: (base / path).resolve() for name, path in named.items() if path is not None}
        )
