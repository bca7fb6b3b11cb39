"""A calibration whose new table makes the machine worse, because the controller subtracts its corrections: status,
page, list, history and report name the same end."""

from __future__ import annotations

import json
from collections.abc import Iterator

import pytest
from panel_pages import settings, with_token
from playwright.sync_api import Page, expect
from service_process import Service, service, simulator

REVERSED = '\n[store]\nsigns = "reversed"\n'
NAME, WORD = "proof-failed", "Proof failed"


@pytest.fixture(scope="module")
def house(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    directory = tmp_path_factory.mktemp("reversed")
    with simulator(directory, REVERSED) as (_, ready), service(settings(ready, directory)) as running:
        yield running


def test_a_table_that_failed_its_proof_has_one_name_everywhere(page: Page, house: Service) -> None:
    with_token(page, house)
    run_id = house.start()
    ended = house.reached("complete", "refused", "faulted")
    assert (ended["verdict"]["name"], ended["verdict"]["word"]) == (NAME, WORD)
    assert ended["active_bank"] == 0
    (run,) = house.get("/api/runs?limit=1")["runs"]
    assert (run["run_id"], run["verdict"]) == (run_id, ended["verdict"])
    assert run["held_out_after_um"] > run["held_out_before_um"]
    expect(page.locator("#state")).to_have_attribute("data-verdict", NAME)
    expect(page.locator("#state .word")).to_have_text(WORD)
    expect(page.locator("#doing")).to_have_text(ended["verdict"]["sentence"])
    expect(page.locator("#result .verdict")).to_have_attribute("data-verdict", NAME)
    expect(page.locator("#result")).to_contain_text(f"{run['held_out_after_um']:.2f}")
    expect(page.locator("#recent")).to_contain_text(WORD)
    listed = json.loads(house.command("history", "list", "--json").stdout)["runs"]
    assert listed[-1]["verdict"] == ended["verdict"]
    assert house.command("report", run_id, "--out", str(house.directory)).returncode == 0
    assert WORD in (house.directory / "report.html").read_text()
    page.click("#tab-engineer")
    page.click("#section-reports")
    expect(page.locator("#content tbody tr").first.locator(".verdict")).to_have_attribute("data-verdict", NAME)
