"""`volcal plan --preview`: what it writes and says, and the page's own program run on a page of plain objects."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from aloud import NOT_HERE
from click.testing import CliRunner, Result
from volcal_command import volcal

from agent.cli.main import main
from agent.errors import PlanRefused
from agent.planning.preview.preview_files import PROGRAM

CONFIG = Path(__file__).resolve().parents[2] / "config" / "case-study.toml"
PACKAGE = Path(__file__).resolve().parents[2] / "agent" / "planning" / "preview"
S1_AT_2 = ("plan", "--config", str(CONFIG), "--position-set", "S1", "--stations", "2")
REFUSED_STEP = "measure/station-2/az0-el0/ball-05/touch-0/start"


def plan(*more: str | Path) -> Result:
    return volcal(*S1_AT_2, *more, exit_code=None)


def refuse(monkeypatch: pytest.MonkeyPatch) -> None:
    def preflight_of(_: object, **__: object) -> None:
        raise PlanRefused("preflight: collision: ram with post 4", hint="the plan must change", step=REFUSED_STEP)

    monkeypatch.setattr("agent.cli.run_commands.plan.preflight_of", preflight_of)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict]:
    """The folder of a preview, and what the command said as JSON."""
    folder = tmp_path_factory.mktemp("plan") / "new" / "folder"
    done = plan("--preview", folder, "--json")
    assert done.exit_code == 7, done.stderr
    assert "verification.min_gain" in done.stderr  # S1 at one station tells too little
    return folder, json.loads(done.stdout)


def test_picture_and_page_are_written_and_named(written: tuple[Path, dict]) -> None:
    folder, said = written
    assert said["files"] == [str(folder / "plan.png"), str(folder / "plan.html")]
    assert sorted(path.name for path in folder.iterdir()) == ["plan.html", "plan.png"]
    assert (folder / "plan.png").read_bytes().startswith(b"\x89PNG")
    page = (folder / "plan.html").read_text(encoding="utf-8")
    assert f"{said['unreachable_balls']}," in page.split('"unreachable":', 1)[1]
    assert json.loads(data_of(page))["minutes"] == pytest.approx(said["machine_minutes"], abs=0.01)


def test_positions_in_which_a_wrong_one_of_three_touches_cannot_be_told_are_counted(tmp_path: Path) -> None:
    listed = tmp_path / "few.csv"
    listed.write_text(
        "station,azimuth_deg,elevation_deg,balls\n"
        "1,0,-30,0 5 10\n1,-60,15,0 3 6 10\n1,15,30,0 2 5 8 10\n2,0,0,\n3,-60,60,\n3,0,0,\n"
    )
    quick = ("plan", "--config", CONFIG.with_name("quick.toml"), "--position-set", listed)
    said = json.loads(volcal(*quick, "--json", exit_code=None).stdout)
    assert said["unchecked_positions"] == 2
    told = " ".join(volcal(*quick, exit_code=None).stdout.split())
    assert re.search(r"2 of \d+ positions have fewer than 5 balls", told)
    assert json.loads(plan("--json").stdout)["unchecked_positions"] is None  # five touches of a ball are enough


def test_without_a_preview_its_drawing_is_not_even_imported() -> None:
    code = "import sys, agent.cli.run_commands.plan; print([m for m in sys.modules if 'preview' in m])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=600.0, check=True)
    assert done.stdout.strip() == "[]"


def test_the_folder_has_a_name_where_none_is_given(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    refuse(monkeypatch)
    assert plan("--preview", "--json").exit_code == 4
    assert sorted(path.name for path in (tmp_path / "preview").iterdir()) == ["plan.html", "plan.png"]


def test_a_refused_plan_is_drawn_and_stays_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    refuse(monkeypatch)
    done = plan("--preview", tmp_path)
    assert done.exit_code == 4
    assert done.stdout == ""
    *files, error = done.stderr.splitlines()
    assert files == [f"preview: {tmp_path / name}" for name in ("plan.png", "plan.html")]
    assert error.startswith(f"error: preflight: collision: ram with post 4 (step {REFUSED_STEP})")
    page = (tmp_path / "plan.html").read_text(encoding="utf-8")
    refusal = json.loads(data_of(page))["refusal"]
    assert (refusal["step"], refusal["bodies"]) == (REFUSED_STEP, ["ram", "post 4"])
    assert "Colliding bodies: <b>ram and post 4</b>" in page


@pytest.mark.parametrize("where", ["a file", "below a file", "not writable"])
def test_a_folder_that_cannot_be_written_is_said_before_the_preflight(
    where: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "taken").write_text("")
    folder = {"a file": tmp_path / "taken", "below a file": tmp_path / "taken" / "x", "not writable": Path("/proc/x")}
    monkeypatch.setattr(
        "agent.cli.run_commands.plan.preflight_of", lambda *_, **__: pytest.fail("preflight run in vain")
    )
    done = plan("--preview", folder[where])
    assert done.exit_code == 2
    assert done.stdout == ""
    [line] = done.stderr.splitlines()
    assert ("a directory is needed" if "file" in where else "cannot be written") in line
    assert "choose another directory" in line
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]


def test_nothing_within_reach_is_said_and_nothing_drawn(tmp_path: Path) -> None:
    text = CONFIG.read_text(encoding="utf-8")
    for folder in ("machines", "artefacts"):
        text = text.replace(f'"{folder}/', f'"{CONFIG.parent}/{folder}/')
    far = [[x, 9000.0, 750.0] for x in (700.0, 1567.0, 2433.0, 3300.0)]
    lines = [f"places_mm = {far}" if line.startswith("places_mm") else line for line in text.splitlines()]
    (tmp_path / "far.toml").write_text("\n".join(lines), encoding="utf-8")
    arguments = ["plan", "--config", str(tmp_path / "far.toml"), "--preview", str(tmp_path / "out")]
    done = CliRunner().invoke(main, arguments)
    assert done.exit_code == 2
    assert "no position has three balls within the travel" in done.stderr
    assert not (tmp_path / "out").exists()


# ------------------------------------------------------------------ the page's program

NODE = shutil.which("node")
STAND_IN = r"""
const fs = require("fs");
const handlers = {}, elements = {}, calls = {};
const style = { getPropertyValue: (name) => ` colour${name} ` };
const surface = new Proxy({}, { get: (_, name) => (...args) => {
  if (args.some((a) => typeof a === "number" && !Number.isFinite(a))) throw new Error(`${String(name)}(${args})`);
  calls[name] = (calls[name] || 0) + 1;
}, set: () => true });
const make = (id) => ({ id, tagName: "DIV", dataset: {}, style: {}, hidden: false, textContent: "", items: [],
  getContext: () => surface, getBoundingClientRect: () => ({ width: 980, height: 700 }), focus() {},
  setPointerCapture() {},
  append(...more) { this.items.push(...more); }, replaceChildren(...more) { this.items = more; },
  addEventListener(type, act) { handlers[`${id}/${type}`] = act; } });
const at = (id) => (elements[id] ||= make(id));
at("data").textContent = fs.readFileSync(process.argv[2], "utf8");
let frames = [];
Object.assign(globalThis, {
  window: { devicePixelRatio: 2 }, getComputedStyle: () => style, matchMedia: () => make("media"),
  requestAnimationFrame: (act) => frames.push(act), cancelAnimationFrame: () => (frames = []),
  ResizeObserver: class { observe() {} },
  document: { getElementById: at, documentElement: {}, createElement: make, querySelectorAll: () => [],
    addEventListener: (type, act) => (handlers[`document/${type}`] = act) },
});
const draw = (ms = 0) => { const now = frames; frames = []; now.forEach((act) => act(performance.now() + ms)); };
const key = (name, more = {}) => {
  handlers["document/keydown"]({ key: name, target: at("view"), preventDefault() {}, ...more });
  draw();
};
const panel = () => ["which", "phase", "minutes", "reach", "at"].map((id) => at(id).textContent);
"""
SESSION = r"""
const told = {};
draw();
told.first = panel();
told.legend = at("legend").items.map((li) => li.items[li.items.length - 1]);
key("ArrowRight");
told.second = panel();
key("ArrowUp");
key("End");
told.last = panel();
key("ArrowLeft", { shiftKey: true });
key("+"); key("f"); key("2");
at("view").tagName = "CANVAS";
const found = [];
for (let x = 0; x < 980; x += 5) for (let y = 0; y < 700; y += 5) {
  handlers["view/pointermove"]({ pointerId: 1, offsetX: x, offsetY: y, buttons: 0 });
  if (!at("tip").hidden) found.push(at("tip").textContent);
}
told.balls = [...new Set(found)];
handlers["view/pointerdown"]({ pointerId: 1, offsetX: 100, offsetY: 100 });
handlers["view/pointermove"]({ pointerId: 1, offsetX: 150, offsetY: 120, buttons: 1 });
handlers["view/pointerdown"]({ pointerId: 2, offsetX: 300, offsetY: 300 });
handlers["view/pointermove"]({ pointerId: 2, offsetX: 340, offsetY: 330, buttons: 1 });
handlers["view/pointerup"]({ pointerId: 2, offsetX: 340, offsetY: 330 });
handlers["view/pointerup"]({ pointerId: 1, offsetX: 150, offsetY: 120 });
handlers["view/wheel"]({ preventDefault() {}, deltaY: -100, deltaMode: 0, offsetX: 10, offsetY: 10 });
key("Home");
key(" ");
told.playing = at("play").textContent;
told.begun = at("within").value;
draw(1000); draw(2000);
told.reached = at("within").value;
told.length = at("within").max;
key(" ");
told.paused = at("play").textContent;
told.played = panel();
told.arcs = calls.arc;
console.log(JSON.stringify(told));
"""


def data_of(page: str) -> str:
    return page.split('id="data">', 1)[1].split("</script>", 1)[0]


def run_page(folder: Path, tmp_path: Path) -> dict:
    """Run the page's program with a document of plain objects; its canvas refuses numbers that are none."""
    (tmp_path / "data.json").write_text(data_of((folder / "plan.html").read_text(encoding="utf-8")), encoding="utf-8")
    program = "\n".join((PACKAGE / name).read_text(encoding="utf-8") for name in PROGRAM)
    (tmp_path / "page.cjs").write_text(
        f'"use strict";{STAND_IN}\n(() => {{\n{program}\n}})();\n{SESSION}', encoding="utf-8"
    )
    command = [str(NODE), str(tmp_path / "page.cjs"), str(tmp_path / "data.json")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600.0, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.skipif(NODE is None, reason=f"{NOT_HERE}: the program of the preview's page: node is missing")
class TestProgram:
    def test_keys_pointer_and_playing(self, written: tuple[Path, dict], tmp_path: Path) -> None:
        folder, said = written
        told = run_page(folder, tmp_path)
        data = json.loads(data_of((folder / "plan.html").read_text(encoding="utf-8")))
        count = len(data["visits"])
        first = said["order"][0].removeprefix("station-2/az").split("-el", 1)
        assert told["first"][0] == f"Position 1 of {count}: station 2, azimuth {first[0]}°, elevation {first[1]}°"
        assert told["first"][4].endswith(", touching")
        assert told["second"][0].startswith("Position 2 of")
        assert told["last"][0] == f"Position {count} of {count}: station 2, azimuth 90°, elevation 0°"
        assert told["last"][1] == "left out: 0 of its balls can be reached, 3 are needed"
        minutes = [float(part) for part in told["last"][2].split(" of ")]
        assert minutes == pytest.approx([said["machine_minutes"]] * 2, abs=0.1)
        assert f"{said['unreachable_balls']} balls out of reach" in told["legend"]
        assert (told["playing"], told["paused"]) == ("pause", "play")
        assert told["begun"] == 0
        assert 2 / 3.5 - 0.02 < told["reached"] / (told["length"] + 1) < 2.5 / 3.5
        assert told["arcs"] > 500

    def test_the_pointer_finds_balls_and_says_why_one_is_out_of_reach(
        self, written: tuple[Path, dict], tmp_path: Path
    ) -> None:
        folder, _ = written
        balls = run_page(folder, tmp_path)["balls"]
        assert len(balls) > 20
        assert any("outside the travel: Y" in text for text in balls)
        assert any("no access: " in text for text in balls)
        assert any("\nreachable\n" in text for text in balls)

    def test_a_refused_plan_opens_at_the_refused_step(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        refuse(monkeypatch)
        assert plan("--preview", tmp_path).exit_code == 4
        told = run_page(tmp_path, tmp_path)
        assert "azimuth 0°, elevation 0°" in told["first"][0]
        minutes = told["first"][2].split(" of ")
        assert minutes[0] == minutes[1]
        assert told["last"][1].startswith(("not reached: ", "left out: "))
