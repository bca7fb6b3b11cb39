"""Address of the page at which another device is paired, and its picture."""

from __future__ import annotations

from ipaddress import ip_address
from urllib.parse import urlsplit

from agent.settings.service import ServiceSettings


def page_address(service: ServiceSettings, url: str, code: str) -> str:
    """Return the address of the page with the code in its fragment, which a browser never sends. `url` is the address
    at which this computer reaches the service; other computers use the first of `service.host_names`."""
    found = urlsplit(url)
    if not service.host_names or service.loopback:
        return f"{url.rstrip('/')}/#pair={code}"
    host = service.host_names[0]
    port = "" if found.port is None else f":{found.port}"  # the usual port of the scheme is not stated
    return f"{found.scheme}://{f'[{host}]' if ':' in host else host}{port}/#pair={code}"


def is_reachable(address: str) -> bool:
    """Return False if only this computer reaches the address."""
    host = urlsplit(address).hostname or ""
    try:
        return not ip_address(host).is_loopback
    except ValueError:
        return host != "localhost"


def qr_picture(address: str) -> str:
    """Return the QR code of the address as a data URI with an SVG."""
    import segno  # noqa: PLC0415  only whoever pairs a device needs it

    # dark on a light ground with its quiet zone, whatever the colours of the page are: readers expect it
    found: str = segno.make(address, micro=False).svg_data_uri(scale=8, border=4, dark="#000", light="#fff")
    return found
