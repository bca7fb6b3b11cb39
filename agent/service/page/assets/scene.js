/* Live view: workspace, artefact at its station with the state of its balls, probe where the run has led it, and the rest of
   the path in this position. Drawn by the scripts of the preview, only when something has changed. */
import { machineOf, paintMachine } from "./bare-machine.js";
import { make } from "./dom.js";
import { listenTo } from "./gestures.js";
import { onLanguage, say } from "./language.js";
import { read } from "./requests.js";
import { markAxes, markBalls } from "./scene-marks.js";
import { axesText, ballStates, progressOf, sceneText, visitOf } from "./scene-state.js";
import { on, seen } from "./store.js";
import { onTheme } from "./theme.js";

/* globals Camera, readPlan, paint, boxCorners, added */
const COLOURS = ["paper", "ink", "quiet", "red", "steel", "ram", "probe", "table", "path", "path-now", "accepted", "wait-ink", "accent"];
const VIEWS = ["isometric", "xy", "xz", "yz"], BALLS = ["measured", "next", "rejected", "lost", "unreached"];
const PREPARING = ["preflight", "resuming"];
const ALWAYS_TOLD = new Set(["measured", "next"]);
const ZOOM = 1.3, BESIDE_PX = 8;

export function openScene(stage) {
  const canvas = make("canvas", { role: "img", tabIndex: 0 });
  const legend = make("div", { className: "legend" });
  const turns = make("div", { className: "turns" });
  const axes = make("p", { className: "axes", id: "axes" });
  const note = make("p", { className: "stage-note", role: "status" });
  const text = make("p", { className: "unseen", id: "scene-text" });
  canvas.setAttribute("aria-describedby", text.id);
  stage.replaceChildren(canvas, legend, turns, axes, note, text);
  const view = new View(canvas, { note, axes, text, legend, turns });
  const name = () => {
    canvas.setAttribute("aria-label", say("scene.name"));
    legend.replaceChildren(...BALLS.map((kind) => make("span", { className: kind, hidden: !ALWAYS_TOLD.has(kind) }, say(`scene.${kind}`))));
    turns.replaceChildren(...VIEWS.map((from) => make("button", { onclick: () => view.look(from) }, say(`scene.from_${from}`))),
      make("button", { onclick: () => view.closer(), ariaPressed: String(view.near), id: "closer" }, say("scene.closer")),
      ...[["+", ZOOM, "in"], ["−", 1 / ZOOM, "out"]].map(([sign, factor, key]) =>
        make("button", { className: "zoom", onclick: () => view.zoom(factor), ariaLabel: say(`scene.zoom_${key}`), title: say(`scene.zoom_${key}`) }, sign)));
    view.showMessage();
    view.show();
  };
  name();
  onLanguage(name);
  onTheme(() => view.show());
  on("status", (status) => view.follow(status));
  on("run", () => view.show());
  on("ball", () => view.show());
  new ResizeObserver(() => view.resize()).observe(stage);
}

class View {
  constructor(canvas, texts) {
    this.canvas = canvas;
    this.texts = texts;
    this.context = canvas.getContext("2d");
    this.camera = new Camera();
    this.plan = this.machine = null;
    this.message = "";
    this.asked = this.progress = 0;
    this.near = matchMedia("(max-width: 600px)").matches; // the artefact is small in a small picture of the machine
    listenTo(canvas, this.camera, () => this.show());
  }

  /* The path of a run is available once its preflight has passed; between runs the path of the next run is shown. */
  follow({ run_id: run, state, may, step, axis_mm: axes }) {
    const wanted = `${may.includes("start") || PREPARING.includes(state) ? "next" : run} ${PREPARING.includes(state)}`;
    if (wanted !== this.wanted) {
      this.wanted = wanted;
      this.load();
    }
    const shown = `${step} ${axes}`;
    if (shown !== this.shown) this.show();
    this.shown = shown;
  }

  /* Only the response to the latest request is used: a late one must not show an outdated plan. Until it is there, the
     plan that is drawn stays, without a message over it. */
  async load() {
    const mine = ++this.asked;
    try {
      if (!this.machine) await this.drawMachine();
      if (!this.plan) this.showMessage("scene.computing");
      const plan = readPlan(JSON.stringify(await read("/api/plan")));
      if (mine !== this.asked) return;
      const first = this.plan === null;
      Object.assign(this, { plan, progress: 0 });
      this.showMessage("");
      if (first) this.fit();
    } catch {
      if (mine !== this.asked) return;
      this.plan = null;
      this.showMessage("scene.no_path");
    }
    this.show();
  }

  async drawMachine() {
    const found = await read("/api/machine");
    this.offset = found.tool_offset_mm;
    this.machine = machineOf(found);
    this.fit();
    this.show();
  }

  showMessage(message = this.message) {
    this.message = message;
    this.texts.note.textContent = message ? say(message) : "";
  }

  look(name) {
    this.camera.look(name);
    this.fit();
    this.show();
  }

  /* The artefact fills the view, and goes on doing so in the next positions; or the whole machine again. */
  closer() {
    this.near = !this.near;
    document.getElementById("closer").setAttribute("aria-pressed", String(this.near));
    this.fit();
    this.show();
  }

  zoom(factor) {
    this.camera.zoom(factor);
    this.show();
  }

  fit() {
    const drawn = this.plan ?? this.machine;
    if (!drawn) return;
    const visit = this.near && this.plan?.visits[visitOf(this.plan, seen.status?.step)];
    if (visit) this.fitInto(visit.placing.bodies.flatMap(({ a, b }) => [a, b]));
    else this.fitInto([...boxCorners(drawn.travel), ...boxCorners(drawn.table).filter(([, , z]) => z === drawn.table.high[2])]);
  }

  /* Between the legend with the positions of the axes and the buttons. */
  fitInto(points) {
    const { camera, texts: { legend, axes, turns } } = this, { height } = camera;
    const above = axes.offsetTop + (axes.offsetHeight || legend.offsetHeight) + BESIDE_PX, below = turns.offsetHeight + 2 * BESIDE_PX;
    camera.height = Math.max(height - above - below, height / 3);
    camera.fit(points);
    camera.height = height;
    camera.shift(0, (above - below) / 2);
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const ratio = devicePixelRatio || 1;
    Object.assign(this.canvas, { width: width * ratio, height: height * ratio });
    Object.assign(this.camera, { width, height });
    this.context.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.fit();
    this.show();
  }

  /* In the next frame, which browsers leave out while the page is hidden. */
  show() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false;
      this.paint();
    });
  }

  paint() {
    const { context, camera, plan, machine, texts } = this;
    const axes = seen.status?.axis_mm ?? null, step = seen.status?.step;
    setText(texts.axes, axesText(axes));
    if (camera.width < 2) return;
    context.clearRect(0, 0, camera.width, camera.height);
    const colours = coloursNow();
    if (!plan?.visits.length) {
      setText(texts.text, "");
      if (machine) paintMachine(context, camera, machine, colours);
      return;
    }
    const visit = visitOf(plan, step);
    if (this.near && visit !== this.visit) this.fit();
    this.visit = visit;
    const tip = axes && this.offset ? added(axes, this.offset) : null;
    this.progress = tip ? progressOf(plan, visit, step, tip, this.progress) : plan.visits[visit].first;
    const state = { visit, progress: this.progress, path: false, ahead: tip !== null, probe: tip !== null, tip, others: true };
    const stateOf = ballStates(plan.visits[visit].phase, step);
    const met = markBalls(context, paint(context, camera, plan, state, colours), stateOf, plan.visits[visit].placing, colours);
    for (const entry of texts.legend.children) entry.hidden = !ALWAYS_TOLD.has(entry.className) && !met.has(entry.className);
    if (tip) markAxes(context, camera, plan.travel, tip, axes, colours);
    setText(texts.text, sceneText(plan, visit, stateOf, axes));
  }
}

function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

function coloursNow() {
  const style = getComputedStyle(document.documentElement);
  const value = (name) => style.getPropertyValue(`--${name}`).trim();
  const colours = Object.fromEntries(COLOURS.map((name) => [name.replace(/-./, ([, letter]) => letter.toUpperCase()), value(name)]));
  return { ...colours, station: (number) => value(`station-${(number - 1) % 8}`) };
}
