"""Real Chromium before the real `volcal serve` on the real simulator process, in step with its virtual clock."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect, sync_playwright

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "system"))

from panel_pages import at_rest, opened, settings
from service_process import Service, service, simulator

FLAGS = ["--no-sandbox", "--disable-background-networking", "--disable-component-update", "--disable-sync"]

expect.set_options(timeout=600_000)


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
