"""The page shows at once that the machine link, and then the service, is lost."""

from __future__ import annotations

import re
import signal
from pathlib import Path

from panel_pages import opened, settings, with_token
from playwright.sync_api import Browser, expect
from service_process import service, simulator


def test_a_lost_link_is_an_alarm_with_what_to_do_and_a_dead_service_is_unmistakable(
    chromium: Browser, tmp_path: Path
) -> None:
    with simulator(tmp_path) as (machine, ready), service(settings(ready, tmp_path)) as running:
        for page in opened(chromium, running, locale="de"):
            with_token(page, running)
            # Before the first run, the settings are beside those of no run.
            page.click("#tab-engineer")
            page.click("#section-settings")
            expect(page.locator("#content")).to_contain_text("Was der Dienst aus")
            expect(page.locator("#content")).not_to_contain_text("gewählte Lauf")
            page.click("#tab-operator")
            running.start()
            running.until(lambda now: now["balls"] > 2, "balls")
            machine.kill()
            expect(page.locator("#state")).to_have_attribute("data-state", "faulted")
            expect(page.locator("#state .word")).to_have_text("Störung")
            alarm = page.locator(".card.alarm")
            expect(alarm).to_contain_text(re.compile(r"Alarm 31\d: "))
            expect(alarm.locator(".hint")).to_contain_text("Abhilfe: ")
            expect(alarm.locator(".where")).to_contain_text(re.compile(r"Schritt: Station \d, Azimut"))
            expect(page.locator("#stale")).to_be_hidden()
            running.process.send_signal(signal.SIGSTOP)  # hung, not gone
            expect(page.locator("#stale")).to_be_visible(timeout=600_000)
            running.process.send_signal(signal.SIGCONT)
            expect(page.locator("#stale")).to_be_hidden()
            running.process.kill()
            banner = page.locator("#stale")
            expect(banner).to_be_visible(timeout=600_000)
            expect(banner).to_contain_text("keine Verbindung")
            box, viewport = banner.bounding_box(), page.viewport_size
            assert box is not None
            assert viewport is not None
            assert box["width"] == viewport["width"]
            expect(page.locator("body")).to_have_class(re.compile("stale-data"))
            expect(page.locator("#abort")).to_be_enabled()
