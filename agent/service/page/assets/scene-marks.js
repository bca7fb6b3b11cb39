/* Marks of the live view over the drawn bodies: state of each ball, axis positions at the edges of the travel. */
import { number } from "./language.js";

/* globals ring, disc, line, between */
const LEAST_PX = 3.5, MARK_PX = 6, NEXT_PX = 9, EDGE_PX = 1.5, FAINT = 0.4, LABEL_PX = 16;

/* Those of other positions than `current` are faint, as their bodies are. An edge in the colour of the paper sets each mark
   off from the bar behind it. Returns the states that were met. */
export function markBalls(context, onScreen, stateOf, current, colours) {
  const met = new Set();
  for (const { x, y, size, ball, placing } of onScreen) {
    context.globalAlpha = placing === current ? 1 : FAINT;
    const state = stateOf(placing, ball);
    met.add(state);
    if (state === "measured") {
      disc(context, x, y, Math.max(LEAST_PX, size) + EDGE_PX, colours.paper);
      disc(context, x, y, Math.max(LEAST_PX, size), colours.accepted);
    } else if (state === "lost") cross(context, x, y, Math.max(MARK_PX, size), colours);
    else if (state === "rejected") diamond(context, x, y, Math.max(MARK_PX, size) + 2, colours);
    else if (state === "next") ring(context, x, y, Math.max(NEXT_PX, size + 5), colours.pathNow, 3.5);
  }
  context.globalAlpha = 1;
  return met;
}

function cross(context, x, y, size, { paper, red }) {
  for (const [longer, width, colour] of [[EDGE_PX, 3 + 2 * EDGE_PX, paper], [0, 3, red]]) {
    const half = size + longer;
    line(context, [x - half, y - half], [x + half, y + half], width, colour);
    line(context, [x - half, y + half], [x + half, y - half], width, colour);
  }
}

function diamond(context, x, y, size, { paper, waitInk }) {
  context.beginPath();
  for (const [dx, dy] of [[0, -size], [size, 0], [0, size], [-size, 0]]) context.lineTo(x + dx, y + dy);
  context.closePath();
  context.lineWidth = 2 * EDGE_PX;
  context.strokeStyle = paper;
  context.stroke();
  context.fillStyle = waitInk;
  context.fill();
}

/* A slider on each edge of the travel, with its axis position; `tip` is where the tip is, `axes` what the controller shows. */
export function markAxes(context, camera, { low, high }, tip, axes, colours) {
  context.font = "600 12px system-ui, sans-serif";
  context.textAlign = "center";
  context.textBaseline = "middle";
  const labels = []; // a label that would cover another one is left out: the corner of the picture has all three
  [0, 1, 2].forEach((axis) => {
    const end = low.map((value, i) => (i === axis ? high[i] : value));
    const share = Math.min(Math.max((tip[axis] - low[axis]) / (high[axis] - low[axis] || 1), 0), 1);
    const from = camera.project(low), to = camera.project(end), [x, y] = camera.project(between(low, end, share));
    if (Math.hypot(to[0] - from[0], to[1] - from[1]) < 20) return; // seen end on
    disc(context, x, y, 6, colours.accent);
    const text = number(axes[axis], 0), half = context.measureText(text).width / 2 + 4;
    if (labels.some((one) => Math.abs(one.x - x) < one.half + half && Math.abs(one.y - y) < LABEL_PX)) return;
    labels.push({ x, y, half });
    context.fillStyle = colours.paper;
    context.fillRect(x - half, y + 9, 2 * half, LABEL_PX);
    context.fillStyle = colours.ink;
    context.fillText(text, x, y + 17);
  });
}
