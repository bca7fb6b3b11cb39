/* State, panel, pointer, keys. Everything that changes asks for one repaint in the next frame. */
const PLAY_MS = 3500, TURN = 0.08, PICK_PX = 12;

const element = (id) => document.getElementById(id);
const canvas = element("view"), ctx = canvas.getContext("2d");
const plan = readPlan(element("data").textContent);
const camera = new Camera();
const state = { visit: 0, progress: 0, others: true, path: true, probe: true };
let colours = readColours(), seen = [], pending = false, view = "isometric";

function readColours() {
  const style = getComputedStyle(document.documentElement);
  const named = (name) => style.getPropertyValue(`--${name}`).trim();
  const own = Object.fromEntries(["paper", "ink", "quiet", "red", "steel", "ram", "probe", "table"].map((n) => [n, named(n)]));
  const stations = [...Array(8).keys()].map((i) => named(`station-${i}`));
  const paths = { path: named("path"), pathNow: named("path-now") };
  return { ...own, ...paths, station: (number) => stations[plan.stations.indexOf(number) % stations.length] };
}

function repaint() {
  if (pending) return;
  pending = true;
  requestAnimationFrame(paintNow);
}

function paintNow() {
  pending = false;
  seen = paint(ctx, camera, plan, state, colours);
}

/* ---- where we look */

function look(name) {
  view = name;
  camera.look(name);
  camera.fit(everything());
  repaint();
}

function everything() {
  const bars = plan.placings.flatMap((placing) => [placing.bar.a, placing.bar.b, ...placing.balls.map((ball) => ball.centre)]);
  return [...boxCorners(plan.travel), ...boxCorners(tableTop(plan.table)), ...bars];
}

function closer() {
  view = "";
  const placing = plan.visits[state.visit].placing;
  const refused = plan.refusal && plan.refusal.visit === state.visit;
  const around = refused ? boxCorners(boxAbout(plan.refusal.tip, 250)) : [placing.bar.a, placing.bar.b, ...placing.balls.map((ball) => ball.centre)];
  camera.fit(around);
  repaint();
}

const boxAbout = (p, half) => ({ low: p.map((value) => value - half), high: p.map((value) => value + half) });

function resize() {
  const box = canvas.getBoundingClientRect(), ratio = window.devicePixelRatio || 1;
  canvas.width = Math.round(box.width * ratio);
  canvas.height = Math.round(box.height * ratio);
  ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
  [camera.width, camera.height] = [box.width, box.height];
  if (view) look(view);
  paintNow(); // a canvas of another size is empty, and must not be shown so
}

/* ---- which position, and how far on the path */

function goTo(visit) {
  state.visit = Math.min(plan.visits.length - 1, Math.max(0, visit));
  state.progress = restAt(plan, state.visit);
  describe();
}

function progressTo(point) {
  const visit = plan.visits[state.visit];
  if (point >= visit.end && state.visit + 1 < plan.visits.length && !plan.visits[state.visit + 1].note) state.visit += 1;
  else if (point < visit.first && state.visit > 0) state.visit -= 1;
  const now = plan.visits[state.visit];
  state.progress = Math.max(now.first, Math.min(now.end - 1, point));
  if (now.note) state.progress = restAt(plan, state.visit);
  describe();
}

function describe() {
  const visit = plan.visits[state.visit], { placing } = visit, { path } = plan;
  element("which").textContent = `Position ${state.visit + 1} of ${plan.visits.length}: station ${placing.station}, azimuth ${placing.az}°, elevation ${placing.el}°`;
  element("phase").textContent = phaseOf(visit);
  const seconds = path.ends[state.progress] || 0;
  element("minutes").textContent = `${(seconds / 60).toFixed(1)} of ${plan.minutes.toFixed(1)}`;
  element("reach").textContent = `${placing.reachable} of ${placing.balls.length}`;
  element("at").textContent = whereTheProbeIs(visit);
  element("unreached").replaceChildren(...placing.balls.filter((ball) => ball.whyNot).map((ball) => item("", `ball ${ball.number}: ${ball.whyNot}`)));
  element("visit").value = state.visit;
  const within = element("within");
  within.disabled = Boolean(visit.note);
  within.max = Math.max(0, visit.end - visit.first - 1);
  within.value = state.progress - visit.first;
  repaint();
}

function whereTheProbeIs(visit) {
  if (visit.note) return "–";
  const ball = plan.path.ballAt[state.progress];
  if (ball < 0) return "on the way";
  return plan.path.touches[state.progress] ? `ball ${ball}, touching` : `ball ${ball}`;
}

let frame = null, lastMs = 0, owed = 0;

function play() {
  if (frame !== null) return pause();
  const last = plan.visits.filter((visit) => !visit.note).length - 1;
  if (state.visit > last || (state.visit === last && state.progress === plan.path.tips.length - 1)) state.visit = 0;
  state.progress = plan.visits[state.visit].first;
  [lastMs, owed] = [performance.now(), 0];
  frame = requestAnimationFrame(advance);
  element("play").textContent = "pause";
}

function pause() {
  cancelAnimationFrame(frame);
  frame = null;
  element("play").textContent = "play";
}

/* Every position takes the same time on the screen. */
function advance(nowMs) {
  const visit = plan.visits[state.visit], before = state.progress;
  owed += (Math.max(0, nowMs - lastMs) * Math.max(1, visit.end - visit.first)) / PLAY_MS;
  lastMs = nowMs;
  const whole = Math.floor(owed);
  owed -= whole;
  if (whole > 0) progressTo(before + whole);
  if (whole > 0 && state.progress === before) pause();
  else frame = requestAnimationFrame(advance);
}

/* ---- panel */

function item(mark, text, style = {}) {
  const li = document.createElement("li");
  if (mark) {
    const span = document.createElement("span");
    span.className = mark;
    Object.assign(span.style, style);
    li.append(span);
  }
  li.append(text);
  return li;
}

function legend() {
  const stations = plan.stations.map((station) => {
    const count = plan.placings.filter((placing) => placing.station === station).length;
    const colour = colours.station(station);
    return item("bar", `station ${station}, ${count} position${count === 1 ? "" : "s"}`, { background: colour });
  });
  const first = colours.station(plan.stations[0]);
  const balls = [
    item("mark", `${plan.balls - plan.unreachable} balls within reach`, { background: first, borderColor: first }),
    item("mark", `${plan.unreachable} balls out of reach`, { borderColor: colours.red }),
  ];
  const path = item("bar", "path in this position", { background: colours.pathNow, height: "2px" });
  const past = item("bar", "path before", { background: colours.path, height: "1px", opacity: "0.5" });
  element("legend").replaceChildren(...stations, ...balls, path, past);
}

/* ---- pointer: one drags, two pinch and shift */

const pointers = new Map();

function onDown(event) {
  canvas.focus({ preventScroll: true });
  canvas.setPointerCapture(event.pointerId);
  pointers.set(event.pointerId, [event.offsetX, event.offsetY]);
}

function onMove(event) {
  const before = pointers.get(event.pointerId), now = [event.offsetX, event.offsetY];
  if (!before) return hover(...now);
  const others = [...pointers].filter(([id]) => id !== event.pointerId).map(([, at]) => at);
  pointers.set(event.pointerId, now);
  const dx = now[0] - before[0], dy = now[1] - before[1];
  if (Math.abs(dx) + Math.abs(dy) > 0) view = "";
  if (others.length) {
    const gap = (at) => Math.hypot(at[0] - others[0][0], at[1] - others[0][1]) || 1;
    camera.shift(dx / 2, dy / 2);
    camera.zoom(gap(now) / gap(before), (now[0] + others[0][0]) / 2, (now[1] + others[0][1]) / 2);
  } else if (event.buttons & 6 || event.shiftKey) camera.shift(dx, dy);
  else camera.turn(-dx * 0.006, dy * 0.006);
  element("tip").hidden = true;
  return repaint();
}

function onUp(event) {
  pointers.delete(event.pointerId);
  hover(event.offsetX, event.offsetY);
}

function hover(x, y) {
  const current = plan.visits[state.visit].placing;
  let best = null, least = Infinity;
  for (const spot of seen) {
    const away = Math.hypot(spot.x - x, spot.y - y) - Math.max(0, spot.size - PICK_PX);
    const rank = away - (spot.placing === current ? 4 : 0) - spot.depth * 1e-5;
    if (away <= PICK_PX && rank < least) [best, least] = [spot, rank];
  }
  const tip = element("tip");
  tip.hidden = best === null;
  if (best === null) return;
  tip.textContent = wordsFor(best.placing, best.ball);
  tip.style.left = `${Math.max(4, Math.min(x + 16, camera.width - 290))}px`;
  tip.style.top = `${y > camera.height - 110 ? y - 100 : y + 16}px`;
}

function wordsFor(placing, ball) {
  const visit = plan.visits.find((one) => one.placing === placing);
  const measured = visit && visit.note ? `within reach; position ${visit.note}` : "reachable";
  const [x, y, z] = ball.centre.map((value) => value.toFixed(1));
  return `ball ${ball.number}, station ${placing.station}\nazimuth ${placing.az}°, elevation ${placing.el}°\n${ball.whyNot || measured}\ncentre ${x}, ${y}, ${z} mm`;
}

function onWheel(event) {
  event.preventDefault();
  view = "";
  camera.zoom(Math.exp(-event.deltaY * (event.deltaMode ? 0.05 : 0.0015)), event.offsetX, event.offsetY);
  repaint();
}

/* ---- keys */

const ACTIONS = { previous: () => goTo(state.visit - 1), next: () => goTo(state.visit + 1), play, closer };
const KEYS = {
  ArrowLeft: ACTIONS.previous,
  ArrowRight: ACTIONS.next,
  ArrowUp: () => progressTo(state.progress + 1),
  ArrowDown: () => progressTo(state.progress - 1),
  Home: () => goTo(0),
  End: () => goTo(plan.visits.length - 1),
  " ": play,
  f: closer,
  "+": () => zoomed(1.2),
  "=": () => zoomed(1.2),
  "-": () => zoomed(1 / 1.2),
  1: () => look("isometric"),
  2: () => look("xy"),
  3: () => look("xz"),
  4: () => look("yz"),
};
const TURNS = { ArrowLeft: [TURN, 0], ArrowRight: [-TURN, 0], ArrowUp: [0, -TURN], ArrowDown: [0, TURN] };

function zoomed(factor) {
  view = "";
  camera.zoom(factor);
  repaint();
}

function onKey(event) {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.key === " " && /^(BUTTON|INPUT|SUMMARY)$/.test(event.target.tagName)) return;
  const turn = event.shiftKey && TURNS[event.key], act = KEYS[event.key.length === 1 ? event.key.toLowerCase() : event.key];
  if (turn) {
    view = "";
    camera.turn(...turn);
    repaint();
  } else if (act && event.target.id !== "within") act();
  else return;
  event.preventDefault();
}

/* ---- begin */

element("visit").max = plan.visits.length - 1;
element("visit").addEventListener("input", (event) => goTo(Number(event.target.value)));
element("within").addEventListener("input", (event) => progressTo(plan.visits[state.visit].first + Number(event.target.value)));
for (const button of document.querySelectorAll("[data-view]")) button.addEventListener("click", () => look(button.dataset.view));
for (const button of document.querySelectorAll("[data-act]")) button.addEventListener("click", () => ACTIONS[button.dataset.act]());
for (const name of ["others", "path", "probe"]) {
  element(`show-${name}`).addEventListener("change", (event) => {
    state[name] = event.target.checked;
    repaint();
  });
}
canvas.addEventListener("pointerdown", onDown);
canvas.addEventListener("pointermove", onMove);
canvas.addEventListener("pointerup", onUp);
canvas.addEventListener("pointercancel", (event) => pointers.delete(event.pointerId));
canvas.addEventListener("pointerleave", () => (element("tip").hidden = true));
canvas.addEventListener("contextmenu", (event) => event.preventDefault());
canvas.addEventListener("wheel", onWheel, { passive: false });
document.addEventListener("keydown", onKey);
new ResizeObserver(resize).observe(canvas);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
  colours = readColours();
  legend();
  repaint();
});
legend();
resize();
goTo(plan.refusal ? plan.refusal.visit : 0);
