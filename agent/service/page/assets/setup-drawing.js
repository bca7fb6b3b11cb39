/* Drawing of a kinematic chain: left which axes carry the tool and which the workpiece, right their directions. */
import { draw, make } from "./dom.js";
import { say } from "./language.js";

const BED_Y = 262, BOX = { width: 118, height: 36, step: 46 };
const COLUMNS = { workpiece: 84, tool: 228 };
const DIRECTIONS = { X: [86, 0], Y: [52, -46], Z: [0, -86] };
const ORIGIN = [480, 168];

/* `chain` as text such as tool-Z-bed-Y-X-workpiece, `spindle` such as -Z, `asked` the axis to be emphasised. */
export function drawChain(chain, spindle, asked = "") {
  const { tool, workpiece } = sides(chain);
  const name = say("drawing.name", { tool: tool.join(", "), workpiece: workpiece.join(", "), spindle });
  return make("div", { className: "drawing", role: "img", ariaLabel: name },
    draw("svg", { viewBox: "0 0 320 300" },
      ...stack(workpiece, COLUMNS.workpiece, say("drawing.workpiece"), asked),
      ...stack([...tool].reverse(), COLUMNS.tool, say("drawing.tool"), asked),
      draw("rect", { x: 14, y: BED_Y, width: 288, height: 30, class: "body" }),
      label(158, BED_Y + 15, say("drawing.bed"))),
    draw("svg", { viewBox: "320 0 320 300" }, ...triad(spindle, asked)));
}

export function sides(chain) {
  const links = chain.split("-").map((link) => link.trim().toUpperCase());
  const bed = links.indexOf("BED");
  return { tool: links.slice(1, bed), workpiece: links.slice(bed + 1, -1) };
}

/* Axes of one side from the bed upwards, and what they carry on top. */
function stack(axes, x, top, asked) {
  const parts = [];
  [...axes, top].forEach((text, i) => {
    const y = BED_Y - BOX.step * (i + 1), isAsked = text === asked && i < axes.length;
    parts.push(draw("line", { x1: x, y1: y + BOX.height, x2: x, y2: y + BOX.step, class: "link" }),
      draw("rect", { x: x - BOX.width / 2, y, width: BOX.width, height: BOX.height, rx: 6, class: isAsked ? "body asked" : "body" }),
      i < axes.length ? label(x, y + BOX.height / 2, `↔ ${text}`, "letter") : label(x, y + BOX.height / 2, text));
  });
  return parts;
}

/* Directions of the tool relative to the workpiece, a workpiece and the stylus in the direction of the spindle. */
function triad(spindle, asked) {
  const [x, y] = ORIGIN, parts = [];
  for (const [axis, [u, v]] of Object.entries(DIRECTIONS)) {
    const kind = axis === asked ? "asked" : "";
    parts.push(draw("line", { x1: x - 0.35 * u, y1: y - 0.35 * v, x2: x + u, y2: y + v, class: `axis ${kind}` }), head(x + u, y + v, u, v, kind),
      label(x + u + (30 * u) / Math.hypot(u, v), y + v + (30 * v) / Math.hypot(u, v), `+${axis}`, "letter"));
  }
  const sign = spindle.startsWith("-") ? -1 : 1;
  const [u, v] = DIRECTIONS[spindle.slice(1)].map((value) => sign * value * 0.62);
  const tip = [x - 34, y + 62];
  parts.push(draw("line", { x1: tip[0] - u, y1: tip[1] - v, x2: tip[0], y2: tip[1], class: "stylus" }),
    draw("circle", { cx: tip[0], cy: tip[1], r: 9, class: "ball" }), label(tip[0], tip[1] + 26, spindle, "letter"));
  return parts;
}

function head(x, y, u, v, kind) {
  const length = Math.hypot(u, v), [a, b] = [u / length, v / length], size = kind ? 16 : 12;
  const points = [[x + a * size, y + b * size], [x - b * size * 0.55, y + a * size * 0.55], [x + b * size * 0.55, y - a * size * 0.55]];
  return draw("polygon", { points: points.map((point) => point.join(",")).join(" "), class: `head ${kind}` });
}

const label = (x, y, text, kind = "") => draw("text", { x, y, class: kind }, text);
