"""A phone is paired with a code of the real `volcal pair`, and starts, sees and is refused what its role says."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from accessibility import violations
from panel_pages import at_rest, opened, with_token
from playwright.sync_api import Browser, Page, ViewportSize, expect
from service_process import Service

MEASURES = (Path(__file__).parent / "measures.js").read_text()
PHONE = ViewportSize(width=390, height=844)
PANEL_SMALL = ViewportSize(width=800, height=480)


def told(house: Service, *arguments: str) -> dict[str, Any]:
    """What `volcal pair` says with these arguments."""
    ended = house.command("pair", "--json", *arguments)
    assert ended.returncode == 0, ended.stderr
    found: dict[str, Any] = json.loads(ended.stdout)
    return found


def fits(page: Page) -> None:
    page.evaluate(MEASURES)
    assert page.evaluate("misplaced(document.querySelector('dialog[open]') ?? undefined)") == []
    assert page.evaluate("unreadable()") == []


def start(page: Page) -> None:
    page.click("#start")
    page.check("input[name=consent]")
    page.click("dialog button[type=submit]")


def test_a_phone_is_paired_and_starts_what_it_may(chromium: Browser, house: Service) -> None:
    at_rest(house)
    for page in opened(chromium, house, has_touch=True):
        page.set_viewport_size(PHONE)
        start(page)
        expect(page.locator("dialog form > p")).to_contain_text("volcal pair")
        page.fill("input[name=code]", "000000")
        page.click("dialog button[type=submit]")
        expect(page.locator("dialog form > p")).to_contain_text("wrong or no longer valid")
        fits(page)
        code = told(house, "--name", "phone at the gate")["code"]
        page.fill("input[name=code]", f"{code[:3]} {code[3:]}")
        page.click("dialog button[type=submit]")

        house.until(lambda now: now["touches"] > 0, "touches")
        expect(page.locator("#token")).to_have_text("Operator · phone at the gate")
        expect(page.locator("#kind")).to_contain_text("started by phone at the gate")
        run = house.get(f"/api/runs/{house.status()['run_id']}")
        assert run["asked"]["by"] == "phone at the gate"
        page.click("#abort")
        expect(page.locator(".card.alarm")).to_contain_text("(phone at the gate)")
        page.click("#reset")
        expect(page.locator("#state")).to_have_attribute("data-state", "idle")
        events = house.get(f"/api/runs/{run['run_id']}/events")
        assert [event["record"] for event in events if event["kind"] == "acknowledged"] == [{"by": "phone at the gate"}]

        # what its role does not permit is not shown, and is refused
        page.click("#tab-engineer")
        page.click("#section-reports")
        expect(page.locator("#content tbody tr")).not_to_have_count(0)
        expect(page.locator("#diagnostics")).to_have_count(0)
        kept = page.evaluate("[sessionStorage.getItem('volcal.token'), localStorage.getItem('volcal.paired')]")
        assert kept[0] is None
        with house.client(Authorization=f"Bearer {kept[1]}") as client:
            assert client.get("/api/diagnostics").json()["title"] == "RoleRefused"

        # the address of the QR code pairs at once, also in a page that is open already, and stays nowhere
        address = told(house, "--role", "engineer", "--name", "tablet")["address"]
        assert re.fullmatch(rf"{re.escape(house.url)}/#pair=\d{{6}}", address)
        page.route("**/api/access", lambda route: route.fulfill(status=503))
        page.goto(address)
        expect(page.locator("#token")).to_have_text("Engineer · tablet")
        page.unroute("**/api/access")
        expect(page.locator("#diagnostics")).to_be_visible()
        assert page.evaluate("location.href") == f"{house.url}/"
        fits(page)
        page.click("#section-settings")
        expect(page.locator("#content tbody")).to_contain_text("procedure.position_set")
        page.click("#token")
        fits(page)
        expect(page.locator("#invite")).to_have_count(0)
        page.keyboard.press("Escape")

        # a revoked client is asked for a new code, and one that signs out is unknown at once
        assert [one["name"] for one in told(house, "--list")["clients"]] == ["phone at the gate", "tablet"]
        told(house, "--revoke", "tablet")
        page.click("#tab-operator")
        start(page)
        expect(page.locator("dialog form > p")).to_contain_text("does not know this device")
        page.keyboard.press("Escape")
        assert house.status()["state"] == "idle"
        page.click("#token")
        page.click("#leave")
        expect(page.locator("#token")).to_have_text("Pair")
    at_rest(house)


def test_the_owner_of_the_machine_pairs_a_device_from_the_page(chromium: Browser, house: Service) -> None:
    at_rest(house)
    for page in opened(chromium, house):
        with_token(page, house)
        page.reload()
        page.set_viewport_size(PANEL_SMALL)
        expect(page.locator("#token")).to_have_text("Engineer")  # the service has said what the token may
        page.click("#token")
        page.click("#invite")
        page.check("input[value=engineer]")
        page.fill("input[name=name]", "tablet of the hall")
        fits(page)
        page.click("dialog button[type=submit]")
        expect(page.locator("dialog img")).to_have_attribute(
            "alt", re.compile(rf"{re.escape(house.url)}/#pair=\d{{6}}")
        )
        page.wait_for_function("document.querySelector('dialog img').naturalWidth > 200", timeout=600_000)
        fits(page)
        assert violations(page) == []
        code = page.locator("#invitation-code").inner_text().replace(" ", "")
        with house.client() as tablet:
            paired = tablet.post("/api/pair", json={"code": code}).json()
        assert (paired["role"], paired["name"]) == ("engineer", "tablet of the hall")
