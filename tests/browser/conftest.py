"""Real Chromium before the real `volcal serve` on the real simulator process, in step with its virtual clock."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, ConsoleMessage, Page, expect, sync_playwright

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "system"))

from service_process import AT_ONCE, Service, service, short_settings, simulator

FLAGS = ["--no-sandbox", "--disable-background-networking", "--disable-component-update", "--disable-sync"]
PANEL = {"width": 1280, "height": 800}
EXPECTED = "Failed to load resource"
"""What Chromium says of every answer that is a refusal; whether a refusal was right is for the tests."""
COARSE = "step_mm = [500.0, 325.0, 500.0]"

expect.set_options(timeout=120_000)


# not the session's: the loop that Playwright runs in this thread must end before tests that run one of their own
@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    path = shutil.which("chromium")
    if path is None:
        pytest.fail("there is no Chromium: the page cannot be tested. `.ci/run` installs it (apt-get install chromium)")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=FLAGS)
        yield browser
        browser.close()


def settings(ready: dict, directory: Path) -> Path:
    """Short runs, nights where the artefact stands, a coarse table."""
    path = short_settings(ready, directory, AT_ONCE)
    text = path.read_text()
    if "standing_at" not in text:
        text = text.replace("[stations]", "[stations]\nstanding_at = 1")
    assert text.count("[table]") <= 1
    text = text.replace("[table]", f"[table]\n{COARSE}") if "[table]" in text else f"{text}\n[table]\n{COARSE}\n"
    path.write_text(f"{text}\n[nightly]\ncheck_positions = 1\n")
    return path


@pytest.fixture(scope="module")
def house(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    directory = tmp_path_factory.mktemp("house")
    with simulator(directory) as (_, ready), service(settings(ready, directory)) as running:
        yield running


@pytest.fixture
def page(chromium: Browser, house: Service) -> Iterator[Page]:
    """At a panel, English, whoever is there knows no token yet; idle before and after. Nothing may go wrong unseen."""
    at_rest(house)
    with_page = opened(chromium, house)
    yield from with_page
    at_rest(house)


def opened(chromium: Browser, house: Service, locale: str = "en", **options: object) -> Iterator[Page]:
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
    assert wrong == []


def at_rest(house: Service) -> None:
    house.post("/api/abort")
    house.reached("idle", "complete", "refused", "aborted", "faulted", within_s=120.0)
    house.post("/api/reset")


def with_token(page: Page, house: Service) -> None:
    """As if somebody had entered it before."""
    page.evaluate("token => sessionStorage.setItem('volcal.token', token)", house.token)
