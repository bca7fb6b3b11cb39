"""Pages of the panel opened in Chromium, and the settings of the service behind them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from playwright.sync_api import Browser, ConsoleMessage, Page, ViewportSize, expect
from service_process import AT_ONCE, Service, short_settings

PANEL = ViewportSize(width=1280, height=800)
EXPECTED = "Failed to load resource"
"""Start of Chromium's message about any refused request; the tests judge if a refusal was right."""
COARSE = "step_mm = [500.0, 325.0, 500.0]"


def settings(ready: dict, directory: Path) -> Path:
    """Write settings for short runs, nights without moving the artefact and a coarse table; return their path."""
    path = short_settings(ready, directory, AT_ONCE)
    text = path.read_text()
    if "standing_at" not in text:
        text = text.replace("[stations]", "[stations]\nstanding_at = 1")
    assert text.count("[table]") <= 1
    text = text.replace("[table]", f"[table]\n{COARSE}") if "[table]" in text else f"{text}\n[table]\n{COARSE}\n"
    path.write_text(f"{text}\n[nightly]\ncheck_positions = 1\n")
    return path


def opened(chromium: Browser, house: Service, locale: str = "en", **options: Any) -> Iterator[Page]:
    context = chromium.new_context(viewport=PANEL, locale=locale, accept_downloads=True, **options)
    page = context.new_page()
    wrong: list[str] = []

    def heard(message: ConsoleMessage) -> None:
        if message.type in ("error", "warning") and not message.text.startswith(EXPECTED):
            wrong.append(message.text)

    page.on("console", heard)
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.goto(house.url)
    expect(page.locator("#state")).to_have_attribute("data-state", house.status()["state"])
    yield page
    context.close()
    assert not wrong, wrong  # this module is not rewritten by pytest


def at_rest(house: Service) -> None:
    house.post("/api/abort")
    house.reached("idle", "complete", "refused", "aborted", "faulted")
    house.post("/api/reset")


def with_token(page: Page, house: Service) -> None:
    """Store the token in the page as if it had been entered before."""
    page.evaluate("token => sessionStorage.setItem('volcal.token', token)", house.token)
