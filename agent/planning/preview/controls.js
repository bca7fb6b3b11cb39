/* State, panel and playback. Every change requests one repaint in the next frame. */
const PLAY_MS = 3500;

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

/* ---- view */

function look(name) {
  view = name;
  camera.look(name);
  camera.fit(everything());
  repaint();
}

function everything() {
  return [...boxCorners(plan.travel), ...boxCorners(tableTop(plan.table)), ...plan.placings.flatMap(extent)];
}

function extent(placing) {
  return [...[...placing.carriers].flatMap((body) => [body.a, body.b]), ...placing.balls.map((ball) => ball.centre)];
}

function closer() {
  view = "";
  const placing = plan.visits[state.visit].placing;
  const refused = plan.refusal && plan.refusal.visit === state.visit;
  const around = refused ? boxCorners(boxAbout(plan.refusal.tip, 250)) : extent(placing);
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
  paintNow(); // resizing clears the canvas; repaint before it is shown
}

/* ---- current position and progress on the path */

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
  if (ball < 0) return "between balls";
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
  describe();
}

function pause() {
  cancelAnimationFrame(frame);
  frame = null;
  element("play").textContent = "play";
}

/* Each position plays in the same time on the screen. */
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
