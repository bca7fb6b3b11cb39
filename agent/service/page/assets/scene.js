/* Live view: workspace, artefact at its station, balls measured, next and not found. Drawn by the scripts of the preview. */
import { machineOf, paintMachine } from "./bare-machine.js";
import { make } from "./dom.js";
import { listenTo } from "./gestures.js";
import { onLanguage, say } from "./language.js";
import { read } from "./requests.js";
import { on, seen } from "./store.js";
import { onTheme } from "./theme.js";
import { placeOf } from "./wording.js";

/* globals Camera, readPlan, paint, boxCorners, ring, disc, line */
const COLOURS = ["paper", "ink", "quiet", "red", "steel", "ram", "probe", "table", "path", "path-now", "go"];
const VIEWS = ["isometric", "xy", "xz", "yz"];
const PREPARING = ["preflight", "resuming"];

export function openScene(stage) {
  const canvas = make("canvas", { role: "img", tabIndex: 0 });
  const legend = make("div", { className: "legend" });
  const turns = make("div", { className: "turns" });
  const note = make("p", { className: "stage-note", role: "status" });
  stage.replaceChildren(canvas, legend, turns, note);
  const view = new View(canvas, note);
  const name = () => {
    canvas.setAttribute("aria-label", say("scene.name"));
    legend.replaceChildren(...["measured", "next", "lost"].map((kind) => make("span", { className: kind }, say(`scene.${kind}`))));
    turns.replaceChildren(...VIEWS.map((from) => make("button", { onclick: () => view.look(from) }, say(`scene.from_${from}`))));
    view.showMessage();
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
  constructor(canvas, note) {
    this.canvas = canvas;
    this.note = note;
    this.context = canvas.getContext("2d");
    this.camera = new Camera();
    this.plan = this.machine = null;
    this.message = "";
    this.asked = 0;
    listenTo(canvas, this.camera, () => this.show());
  }

  /* The path of a run is available once its preflight has passed; between runs the path of the next run is shown. */
  follow({ run_id: run, state, may, step }) {
    const wanted = `${may.includes("start") || PREPARING.includes(state) ? "next" : run} ${PREPARING.includes(state)}`;
    if (wanted !== this.wanted) {
      this.wanted = wanted;
      this.load();
    }
    if (step !== this.step) this.show();
    this.step = step;
  }

  /* Only the response to the latest request is used: a late one must not show an outdated plan. Until it is there, the
     plan that is drawn stays, without a message over it. */
  async load() {
    const mine = ++this.asked;
    try {
      if (!this.plan) await this.drawMachine();
      if (!this.plan) this.showMessage("scene.computing");
      const plan = readPlan(JSON.stringify(await read("/api/plan")));
      if (mine !== this.asked) return;
      const first = this.plan === null;
      this.plan = plan;
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
    this.machine = machineOf(await read("/api/machine"));
    this.fit();
    this.show();
  }

  showMessage(message = this.message) {
    this.message = message;
    this.note.textContent = message ? say(message) : "";
  }

  look(name) {
    this.camera.look(name);
    this.fit();
    this.show();
  }

  fit() {
    const drawn = this.plan ?? this.machine;
    if (drawn) this.camera.fit([...boxCorners(drawn.travel), ...boxCorners(drawn.table).filter(([, , z]) => z === drawn.table.high[2])]);
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

  show() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false;
      this.paint();
    });
  }

  paint() {
    const { context, camera, plan, machine } = this;
    context.clearRect(0, 0, camera.width, camera.height);
    if (camera.width < 2) return;
    const colours = coloursNow();
    if (!plan?.visits.length) {
      if (machine) paintMachine(context, camera, machine, colours);
      return;
    }
    const visit = visitOf(plan, seen.status?.step);
    const state = { visit, progress: plan.visits[visit].first, path: false, probe: false, others: true };
    mark(context, paint(context, camera, plan, state, colours), colours);
  }
}

/* Visit that the step belongs to; the first one if nothing is being measured. */
function visitOf(plan, step) {
  const at = placeOf(step);
  if (!at) return 0;
  const key = `station-${at.station}/az${at.azimuth}-el${at.elevation}`;
  const own = plan.visits.findIndex((visit) => visit.phase === at.phase && visit.placing.key === key);
  return Math.max(own, 0);
}

const keyOf = (station, azimuth, elevation, ball) => `${station}/${Number(azimuth)}/${Number(elevation)}/${ball}`;

function keyOfStep(step) {
  const at = placeOf(step);
  return at && at.ball !== null ? keyOf(at.station, at.azimuth, at.elevation, at.ball) : null;
}

/* A ball that was found later is no longer shown as lost. */
function mark(context, onScreen, colours) {
  const measured = new Set(seen.balls.map((ball) => keyOf(ball.station, ball.azimuth_deg, ball.elevation_deg, ball.ball)));
  const lost = new Set(seen.lost.map(keyOfStep));
  const next = keyOfStep(seen.status?.step);
  for (const { x, y, size, ball, placing } of onScreen) {
    const key = keyOf(placing.station, placing.az, placing.el, ball.number);
    if (measured.has(key)) disc(context, x, y, Math.max(3.5, size), colours.go);
    else if (lost.has(key)) cross(context, x, y, Math.max(6, size), colours.red);
    if (key === next) ring(context, x, y, Math.max(9, size + 5), colours.pathNow, 3.5);
  }
}

function cross(context, x, y, size, colour) {
  line(context, [x - size, y - size], [x + size, y + size], 3, colour);
  line(context, [x - size, y + size], [x + size, y - size], 3, colour);
}

function coloursNow() {
  const style = getComputedStyle(document.documentElement);
  const value = (name) => style.getPropertyValue(`--${name}`).trim();
  const colours = Object.fromEntries(COLOURS.map((name) => [name === "path-now" ? "pathNow" : name, value(name)]));
  return { ...colours, station: (number) => value(`station-${(number - 1) % 8}`) };
}
