/* Pointer, keys and buttons; start of the page. */
const TURN = 0.08, PICK_PX = 12;

/* ---- pointer: one finger turns, two zoom and shift */

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

/* ---- start */

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
