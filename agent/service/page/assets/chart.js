/* A small chart: axes, lines, bands, points with uncertainty, limits. Colours are variables of the theme. */
import { draw } from "./dom.js";
import { number, say } from "./language.js";

const ROOM = { left: 52, right: 10, top: 24, bottom: 34 };
const BESIDE_PX = 20, LEAST_PX = 300, NARROW_TICKS = 2; // on a phone, a chart is drawn narrower and not smaller
const TICKS_X = 5, TICKS_Y = 4, FONT = 12, MOST_DIGITS = 6, SHORT = 6;

/* `x`, `y`: ranges; `nameX`: text of a value on the axis; `unitX`: unit behind the first of them; `draws`: functions that take the scales and return elements. */
export function chart({ name, title, xLabel, yLabel = "", x, y, width: wide = 520, height = 220, draws = [], room = ROOM, ticksX: ticks = TICKS_X, unitX = "", nameX = (value) => figure(value, x) }) {
  const width = Math.min(wide, Math.max(innerWidth - BESIDE_PX, LEAST_PX)), ticksX = width < wide ? Math.min(ticks, NARROW_TICKS) : ticks;
  const inner = { width: width - room.left - room.right, height: height - room.top - room.bottom };
  const scales = {
    x: (value) => room.left + (inner.width * (value - x[0])) / (x[1] - x[0] || 1),
    y: (value) => room.top + inner.height * (1 - (value - y[0]) / (y[1] - y[0] || 1)),
  };
  scales.inside = (value) => Math.min(Math.max(value, y[0]), y[1]);
  const svg = draw("svg", { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": name ?? title, class: "chart", "data-left": room.left, "data-right": width - room.right });
  for (const value of rounded(y, TICKS_Y)) {
    svg.append(draw("line", { x1: room.left, x2: width - room.right, y1: scales.y(value), y2: scales.y(value), class: "grid" }));
    svg.append(label(room.left - 5, scales.y(value) + 4, "end", figure(value, y)));
  }
  const ends = rounded(x, ticksX);
  const named = (value) => (unitX && value === ends[0] ? say("unit.value", { value: nameX(value), unit: unitX }) : nameX(value));
  for (const value of ends) svg.append(label(scales.x(value), height - room.bottom + 18, anchorAt(value, x, named(value).length), named(value)));
  if (y[0] < 0 && y[1] > 0) svg.append(draw("line", { x1: room.left, x2: width - room.right, y1: scales.y(0), y2: scales.y(0), class: "zero" }));
  for (const one of draws) svg.append(...one(scales));
  svg.append(label(room.left, 15, "start", title, "title"), label(width - room.right, height - 3, "end", xLabel), label(width - room.right, 15, "end", yLabel));
  return svg;
}

const label = (x, y, anchor, text, kind = "") => draw("text", { x, y, "text-anchor": anchor, "font-size": FONT, class: kind }, text);

/* Round values inside the range, at most about `count`, and at least two of them: one alone gives no scale. */
export function rounded([low, high], count) {
  const span = high - low;
  if (!(span > 0)) return [low];
  const rough = span / count, power = 10 ** Math.floor(Math.log10(rough));
  const widest = [1, 2, 5, 10].find((factor) => factor * power >= rough);
  const multiples = (step) => {
    const values = [];
    for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * span; k++) values.push(k * step);
    return values;
  };
  const steps = [10, 5, 2, 1, 0.5, 0.2, 0.1].filter((factor) => factor <= widest).map((factor) => factor * power);
  return steps.map(multiples).find((values) => values.length > 1) ?? multiples(steps[0]);
}

/* Aligns the numbers at the ends so that they stay inside the chart. */
function anchorAt(value, [low, high], letters) {
  const share = (value - low) / (high - low || 1);
  const edge = letters > SHORT ? 0.12 : 0.03;
  return share < edge ? "start" : share > 1 - edge ? "end" : "middle";
}

function figure(value, [low, high]) {
  const step = (high - low) / TICKS_Y;
  return number(value, Math.min(Math.max(0, Math.ceil(-Math.log10(step))), MOST_DIGITS));
}

export function reach(values, { zero = false, margin = 0.08 } = {}) {
  const finite = values.filter(Number.isFinite);
  let low = Math.min(...finite, ...(zero ? [0] : [])), high = Math.max(...finite, ...(zero ? [0] : []));
  if (!(high > low)) [low, high] = [low - 0.5, high + 0.5];
  const more = margin * (high - low);
  return [zero && low === 0 ? 0 : low - more, high + more];
}

export const pathOf = (points) => points.map(([x, y], i) => `${i ? "L" : "M"}${x.toFixed(2)} ${y.toFixed(2)}`).join("");

export const line = (xs, ys, kind) => ({ x, y }) => [draw("path", { d: pathOf(xs.map((value, i) => [x(value), y(ys[i])])), class: `line ${kind}` })];

export const band = (xs, low, high, kind) => ({ x, y }) => {
  const there = xs.map((value, i) => [x(value), y(low[i])]), back = xs.map((value, i) => [x(value), y(high[i])]).reverse();
  return [draw("path", { d: `${pathOf([...there, ...back])}Z`, class: `band ${kind}` })];
};

/* With more values than this, single bars and marks would cover each other. */
export const MANY = 120;

export const points = (xs, ys, doubts, kind) => (xs.length > MANY ? manyPoints(xs, ys, doubts, kind) : fewPoints(xs, ys, doubts, kind));

const manyPoints = (xs, ys, doubts, kind) => (scales) => [
  ...(doubts ? band(xs, ys.map((value, i) => scales.inside(value - doubts[i])), ys.map((value, i) => scales.inside(value + doubts[i])), `doubts ${kind}`)(scales) : []),
  ...xs.map((value, i) => draw("circle", { cx: scales.x(value), cy: scales.y(ys[i]), r: 1.5, class: `point ${kind}` })),
];

const fewPoints = (xs, ys, doubts, kind) => ({ x, y, inside }) => xs.flatMap((value, i) => [
  ...(doubts ? [draw("line", { x1: x(value), x2: x(value), y1: y(inside(ys[i] - doubts[i])), y2: y(inside(ys[i] + doubts[i])), class: `doubt ${kind}` })] : []),
  draw("circle", { cx: x(value), cy: y(ys[i]), r: 3.5, class: `point ${kind}` }),
]);

export const level = (value, [from, to], kind) => ({ x, y }) => [draw("line", { x1: x(from), x2: x(to), y1: y(value), y2: y(value), class: `level ${kind}` })];

export const fall = (value, [from, to], kind) => ({ x, y }) => [draw("line", { x1: x(value), x2: x(value), y1: y(from), y2: y(to), class: `level ${kind}` })];
