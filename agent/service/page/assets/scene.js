/* The live view: workspace, artefact where it stands, balls measured, next and lost. Drawn by the preview's scripts. */
import { make } from "./dom.js";
import { onLanguage, say } from "./language.js";
import { read } from "./requests.js";
import { on, seen } from "./store.js";
import { onTheme } from "./theme.js";
import { placeOf } from "./wording.js";

/* globals Camera, readPlan, paint, boxCorners, ring, disc */
const COLOURS = ["paper", "ink", "quiet", "red", "steel", "ram", "probe", "table", "path", "path-now", "go"];
const TURN_PER_PX = 0.008;

export function openScene(stage) {
  const canvas = make("canvas", { role: "img" });
  const legend = make("div", { className: "legend" });
  const turns = make("div", { className: "turns" });
  stage.replaceChildren(canvas, legend, turns);
  const view = new View(canvas);
  const name = () => {
    canvas.setAttribute("aria-label", say("scene.name"));
    legend.replaceChildren(...["measured", "next", "lost"].map((kind) => make("span", { className: kind }, say(`scene.${kind}`))));
    turns.replaceChildren(...["isometric", "xy", "xz", "yz"].map((from) =>
      make("button", { onclick: () => view.look(from) }, say(`scene.from_${from}`))));
  };
  name();
  onLanguage(name);
  onTheme(() => view.show());
  on("run", () => view.load());
  on("status", () => view.show());
  on("ball", () => view.show());
  new ResizeObserver(() => view.resize()).observe(stage);
  view.load();
}

class View {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.camera = new Camera();
    this.plan = null;
    this.asked = 0;
    canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
    canvas.addEventListener("pointermove", (event) => {
      if (!event.buttons) return;
      this.camera.turn(-event.movementX * TURN_PER_PX, event.movementY * TURN_PER_PX);
      this.show();
    });
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.camera.zoom(Math.exp(-event.deltaY / 500), event.offsetX, event.offsetY);
      this.show();
    }, { passive: false });
  }

  /* The latest question wins: an answer that comes late must not show a former plan. */
  async load() {
    const mine = ++this.asked;
    try {
      const plan = readPlan(JSON.stringify(await read("/api/plan")));
      if (mine !== this.asked) return;
      this.plan = plan;
      this.fit();
    } catch {
      if (mine === this.asked) this.plan = null;
    }
    this.show();
  }

  look(name) {
    this.camera.look(name);
    this.fit();
    this.show();
  }

  fit() {
    if (this.plan) this.camera.fit(boxCorners(this.plan.travel));
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
    const { context, camera, plan } = this;
    context.clearRect(0, 0, camera.width, camera.height);
    if (!plan?.visits.length || camera.width < 2) return;
    const colours = coloursNow();
    const visit = visitOf(plan, seen.status?.step);
    const state = { visit, progress: plan.visits[visit].first, path: false, probe: false, others: true };
    const onScreen = paint(context, camera, plan, state, colours);
    mark(context, onScreen, colours);
  }
}

/* The visit that the step belongs to; the first where nothing is measured. */
function visitOf(plan, step) {
  const at = placeOf(step);
  if (!at) return 0;
  const key = `station-${at.station}/az${at.azimuth}-el${at.elevation}`;
  const own = plan.visits.findIndex((visit) => visit.phase === at.phase && visit.placing.key === key);
  return Math.max(own, 0);
}

function mark(context, onScreen, colours) {
  const keyOf = (station, azimuth, elevation, ball) => `${station}/${azimuth}/${elevation}/${ball}`;
  const measured = new Set(seen.balls.map((ball) => keyOf(ball.station, ball.azimuth_deg, ball.elevation_deg, ball.ball)));
  const at = placeOf(seen.status?.step);
  const next = at && at.ball !== null ? keyOf(at.station, Number(at.azimuth), Number(at.elevation), at.ball) : null;
  for (const { x, y, size, ball, placing } of onScreen) {
    const key = keyOf(placing.station, placing.az, placing.el, ball.number);
    if (measured.has(key)) disc(context, x, y, Math.max(3.5, size), colours.go);
    if (key === next) ring(context, x, y, Math.max(9, size + 5), colours.pathNow, 3.5);
  }
}

function coloursNow() {
  const style = getComputedStyle(document.documentElement);
  const value = (name) => style.getPropertyValue(`--${name}`).trim();
  const colours = Object.fromEntries(COLOURS.map((name) => [name === "path-now" ? "pathNow" : name, value(name)]));
  return { ...colours, station: (number) => value(`station-${(number - 1) % 8}`) };
}
