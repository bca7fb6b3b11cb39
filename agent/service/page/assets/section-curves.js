/* Section with the 21 geometric errors of ISO 230-1: 18 functions with ±2σ bands and three squareness errors. */
import { band, chart, line } from "./chart.js";
import { make } from "./dom.js";
import { number, say } from "./language.js";
import { facts, heading, remark } from "./parts.js";
import { read } from "./requests.js";

export const ofRun = true, needsEstimate = true;
const SIGMAS = 2;
const ROOM = { left: 34, right: 6, top: 22, bottom: 22 };
const KINDS = ["EX", "EY", "EZ", "EA", "EB", "EC"];

export async function parts({ run }) {
  const { curves, cross, squareness } = await read(`/api/page/runs/${encodeURIComponent(run)}/curves`);
  const byName = new Map(curves.map((curve) => [curve.name, curve]));
  const reaches = new Map(["µm", "µrad"].map((unit) => [unit, largest(curves.filter((curve) => curve.unit === unit))]));
  const panels = ["X", "Y", "Z"].flatMap((axis) => KINDS.map((kind) => panel(byName.get(kind + axis), kind + axis, reaches)));
  return [
    heading("curves.title"),
    make("div", { className: "curves" }, ...panels),
    squarenesses(squareness),
    ...(cross.length ? [make("h3", {}, say("curves.cross")), make("div", { className: "curves" }, ...cross.map((curve) => panel(curve, curve.name, new Map([[curve.unit, largest([curve])]]))))] : []),
    remark("curves.bands"),
  ];
}

const largest = (curves) => Math.max(1e-3, ...curves.flatMap(({ value, sigma }) => value.map((v, i) => Math.abs(v) + SIGMAS * sigma[i])));

function panel(curve, name, reaches) {
  if (!curve) return make("p", { className: "remark missing" }, say("curves.missing", { name }));
  const { position_mm: at, value, sigma, unit } = curve;
  const top = 1.05 * reaches.get(unit), kind = unit === "µm" ? "displacement" : "rotation";
  const low = value.map((v, i) => v - SIGMAS * sigma[i]), high = value.map((v, i) => v + SIGMAS * sigma[i]);
  return chart({
    title: name, name: say("curves.name", { name }), xLabel: "", yLabel: unit, x: [at[0], at.at(-1)], y: [-top, top], width: 190, height: 130, room: ROOM,
    ticksX: 2, unitX: "mm", draws: [band(at, low, high, kind), line(at, value, kind)],
  });
}

function squarenesses(rows) {
  return facts(rows.map(({ name, value, sigma, unit }) => [`squareness.${name}`, say("unit.with_doubt", { value: number(value, 1), doubt: number(SIGMAS * sigma, 1), unit })]));
}
