"""The section `[service]`: who may reach the service, when it may start by itself, how long it waits."""

from __future__ import annotations

from ipaddress import ip_address
from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, PositiveFloat, model_validator

from twin.formats.toml_reading import Strict

HourSpan = Annotated[str, Field(pattern=r"^([01]\d|2[0-3]):[0-5]\d-([01]\d|2[0-3]):[0-5]\d$")]


class ServiceSettings(Strict):
    """`host`: an address of this computer; any but loopback needs a certificate. `hours` (local time, 22:00-05:30) and
    `warm_up_minutes` since this computer was switched on bind starts that nobody at the machine has consented to."""

    host: str = "127.0.0.1"
    port: int = Field(default=8517, ge=0, le=65535)
    host_names: list[str] = Field(default=[])
    certificate_file: Path | None = None
    key_file: Path | None = None
    token_file: Path | None = None
    warm_up_minutes: float = Field(default=30.0, ge=0.0, le=1440.0)
    hours: list[HourSpan] = Field(default=[])
    answer_within_minutes: PositiveFloat = Field(default=120.0, le=1440.0)
    hung_after_s: float = Field(default=30.0, ge=5.0, le=600.0)
    computing_minutes: PositiveFloat = Field(default=15.0, le=240.0)
    stop_within_s: float = Field(default=60.0, ge=5.0, le=600.0)

    @property
    def loopback(self) -> bool:
        return self.host == "localhost" or ip_address(self.host).is_loopback

    @property
    def reached_at(self) -> str:
        """Host part of the address by which this computer reaches itself."""
        if self.host != "localhost" and ip_address(self.host).is_unspecified:
            return "[::1]" if ":" in self.host else "127.0.0.1"
        return f"[{self.host}]" if ":" in self.host else self.host

    @property
    def scheme(self) -> str:
        return "http" if self.certificate_file is None else "https"

    @model_validator(mode="after")
    def _open_only_with_a_certificate(self) -> Self:
        if self.host != "localhost":
            try:
                ip_address(self.host)
            except ValueError:
                raise ValueError(f"service.host is the address to listen at, and {self.host!r} is none") from None
        if (self.certificate_file is None) is not (self.key_file is None):
            raise ValueError("service.certificate_file and service.key_file belong together")
        if not self.loopback and self.certificate_file is None:
            raise ValueError(
                "service.host is not loopback, so service.certificate_file and service.key_file are needed: "
                "a token must not travel in the clear"
            )
        return self

    def resolved(self, base: Path) -> ServiceSettings:
        """The same with every path made absolute, starting from `base`."""
        named = {name: getattr(self, name) for name in ("certificate_file", "key_file", "token_file")}
        return self.model_copy(
            update={name: (base / path).resolve() for name, path in named.items() if path is not None}
        )
