"""The set-up page in Chromium and a real simulated controller: all steps, jogs, a finger at the stylus, the files."""

from __future__ import annotations

import json
import re
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from accessibility import violations
from panel_pages import PANEL
from playwright.sync_api import Browser, Page, ViewportSize, expect

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "system"))

from simulated import COMMAND, CONFIG, PATIENCE_S

MEASURES = (Path(__file__).parent / "measures.js").read_text()
POSITIONS = "station,azimuth_deg,elevation_deg\n" + "".join(
    f"{station},{azimuth},{elevation}\n"
    for station in (1, 2)
    for azimuth, elevation in ((45, 0), (-45, 0), (0, 45), (0, -45), (90, 45), (90, -45))
)
STEPS = ("machine", "controller", "axes", "chain", "probe", "artefact", "mount", "review")
SMALL = (ViewportSize(width=800, height=480), ViewportSize(width=390, height=844))


@contextmanager
def process(*arguments: str, cwd: Path) -> Iterator[tuple[subprocess.Popen[str], dict[str, Any]]]:
    """A command of ours, and the line of JSON that it prints when it is ready."""
    command, pipe = [*COMMAND, *arguments], subprocess.PIPE
    with subprocess.Popen(command, cwd=cwd, stdin=pipe, stdout=pipe, stderr=pipe, text=True) as running:
        try:
            assert running.stdout is not None
            line = running.stdout.readline()
            assert line, running.communicate()[1]
            yield running, json.loads(line)
        finally:
            running.kill()


def run(directory: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [*COMMAND, *arguments]
    return subprocess.run(command, cwd=directory, capture_output=True, text=True, timeout=600.0, check=False)


@pytest.fixture
def controller(tmp_path: Path) -> Iterator[dict[str, Any]]:
    scenario = CONFIG / "simulators" / "mill.toml"
    with process("simulate", "--config", str(scenario), "--clock", "real", "--end-with-stdin", cwd=tmp_path) as (
        _,
        ready,
    ):
        yield ready


def panel(ready: dict[str, Any], **request: Any) -> dict[str, Any]:
    """Ask the simulator for what a person does at the machine."""
    place = ready["control"]
    with socket.create_connection((place["host"], place["port"]), timeout=PATIENCE_S) as link:
        link.sendall(json.dumps(request).encode() + b"\n")
        answer: dict[str, Any] = json.loads(link.makefile("r").readline())
    assert "error" not in answer, answer
    return answer


def fits(page: Page, step: str) -> None:
    """Every size of window and both languages: nothing is cut, overlaps or cannot be read."""
    page.evaluate(MEASURES)
    assert "`" not in page.inner_text("body"), step
    assert not re.search(r"--[a-z]", page.inner_text("#step").split("volcal ")[0]), step
    for size in (*SMALL, PANEL):
        page.set_viewport_size(size)
        assert page.evaluate("misplaced()") == [], (step, size)
    for theme in ("dark", "light"):
        page.evaluate("theme => (document.documentElement.dataset.theme = theme)", theme)
        assert page.evaluate("unreadable()") == [], (step, theme)
        assert violations(page) == [], (step, theme)


def go_on(page: Page, step: str) -> None:
    fits(page, step)
    page.click("#next")
    expect(page.locator(f"#to-{STEPS[STEPS.index(step) + 1]}")).to_have_attribute("aria-current", "step")


def jog(
    page: Page, ready: dict[str, Any], axis: str, part: str, *, way: float = 6.0, direction: str = "as drawn"
) -> None:
    """Do what the page asks: jog at the machine, and say what was seen."""
    page.click(f"#jog-{axis}")
    expect(page.locator("#jog-live")).to_be_visible()
    panel(ready, do="jog", axis=axis, distance_mm=way)
    expect(page.locator("#jog-live")).to_contain_text(f"{way:.2f}")
    page.check(f"#jog-seen input[value='{direction}']")
    page.check(f"#jog-seen input[value={part}]")
    page.click("#jog-keep")
    expect(page.locator("#jog-seen")).to_have_count(0)


def check_axes(page: Page, ready: dict[str, Any]) -> None:
    """A wrong sign and a wrong chain are named, and gone once they are corrected."""
    jog(page, ready, "X", "workpiece", direction="opposite")
    expect(page.locator(".panel")).to_contain_text("wrong sign")
    page.fill("#field-chain", "tool-Z-X-bed-Y-workpiece")
    page.press("#field-chain", "Tab")
    jog(page, ready, "X", "workpiece")
    expect(page.locator(".panel")).to_contain_text("X belongs after “bed”")
    page.fill("#field-chain", "")
    page.press("#field-chain", "Tab")
    expect(page.locator(".panel")).to_contain_text("X: letter, sign and chain are right")
    jog(page, ready, "Y", "workpiece")
    jog(page, ready, "Z", "tool", way=-6.0)
    expect(page.locator(".result[data-look=good]")).to_have_count(3)


def check_probe(page: Page, ready: dict[str, Any]) -> None:
    page.click("#watch")
    expect(page.locator("#touch")).to_contain_text("no trigger seen yet")
    panel(ready, do="deflect", deflected=True)
    expect(page.locator("#touch")).to_contain_text("let go")
    panel(ready, do="deflect", deflected=False)
    expect(page.locator("#touch")).to_contain_text("the probe works")


def test_all_steps_lead_to_the_files_that_the_command_writes(
    chromium: Browser, controller: dict[str, Any], tmp_path: Path
) -> None:
    (tmp_path / "short.csv").write_text(POSITIONS)
    address = f"127.0.0.1:{controller['modbus']['port']}"
    with process("init", "page/mine", "--page", "--port", "0", "--json", cwd=tmp_path) as (running, ready):
        page = chromium.new_context(viewport=PANEL, locale="en").new_page()
        wrong: list[str] = []
        page.on("console", lambda message: wrong.append(message.text) if message.type in ("error", "warning") else None)
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.goto(ready["url"])
        page.click("#next")
        expect(page.locator("#error-machine_class")).to_have_text("This value is needed.")
        page.select_option("#field-machine_class", "mill")
        go_on(page, "machine")
        page.select_option("#field-controller", "modbus-cnc")
        page.fill("#field-address", address)
        page.press("#field-address", "Tab")
        page.click("#connect")
        expect(page.locator(".data")).to_contain_text("X")
        go_on(page, "controller")
        expect(page.locator("#help-travel")).to_contain_text("Read from the controller")
        expect(page.locator("#to-machine")).to_have_attribute("data-done", "true")
        page.fill("[name=travel-X-highest]", "-500")
        page.press("[name=travel-X-highest]", "Tab")
        expect(page.locator("#error-travel")).to_contain_text("X: the lowest position")
        expect(page.locator("[aria-invalid=true]")).to_have_count(1)
        expect(page.locator("[name=travel-X-highest]")).to_have_attribute("aria-invalid", "true")
        page.fill("[name=travel-X-highest]", "")
        page.press("[name=travel-X-highest]", "Tab")
        expect(page.locator("[aria-invalid=true]")).to_have_count(0)
        page.fill("[name=feed-Y]", "2500,5")
        go_on(page, "axes")
        check_axes(page, controller)
        go_on(page, "chain")
        page.fill("#field-stylus", "soon")
        page.click("#next")
        expect(page.locator("#error-stylus")).to_have_text("“soon” is not a number.")
        page.fill("#field-stylus", "140")
        page.fill("#field-tip_diameter", "5")
        check_probe(page, controller)
        go_on(page, "probe")
        page.fill("#field-balls", "7")
        go_on(page, "artefact")
        page.fill("#field-stations", "2")
        page.fill("#field-position_set", "short.csv")
        page.select_option("#field-touches", "5")
        go_on(page, "mount")
        page.click("#prepare")
        expect(page.locator("#checked")).to_be_visible()
        assert not (tmp_path / "page").exists()
        page.click("#language")
        expect(page.locator(".data")).to_contain_text("Gewinn der neuen Tabelle")
        fits(page, "review")
        page.click("#write")
        expect(page.locator("#written")).to_contain_text("page/mine/preview/plan.html")
        expect(page.locator("#to-review")).to_have_attribute("data-done", "true")
        page.click("#finish")
        expect(page.locator("#finished")).to_be_visible()
        page.context.close()
        running.wait(PATIENCE_S)
        assert wrong == []
        assert running.returncode == 0, running.communicate()[1]
    stated = (
        f"--class mill --controller modbus-cnc --address {address} --feed 3000 2500.5 3000 --stylus 140 "
        "--tip-diameter 5 --balls 7 --stations 2 --touches 5 --position-set short.csv"
    )
    typed = run(tmp_path, "init", "typed/mine", *stated.split())
    assert typed.returncode == 0, typed.stderr
    pages, commands = (tmp_path / way / "mine" for way in ("page", "typed"))
    assert sorted(path.name for path in pages.rglob("*")) == sorted(path.name for path in commands.rglob("*"))
    for name in ("machine.toml", "artefact.toml", "volcal.toml", "simulator.toml"):
        assert (pages / name).read_text() == (commands / name).read_text()
    checked = run(pages, "config", "check", "volcal.toml")
    assert checked.returncode == 0, checked.stderr
