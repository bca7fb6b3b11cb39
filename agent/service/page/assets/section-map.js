/* Section with the error map: expected deviation without and with the table of the run, and its uncertainty, on a plane of the
   workspace that is chosen. */
import { make } from "./dom.js";
import { FieldMap, lengthOf, nearOf } from "./field-map.js";
import { number, say } from "./language.js";
import { showProblem } from "./notices.js";
import { choice, facts, heading, remark } from "./parts.js";
import { scale } from "./plane-map.js";
import { read } from "./requests.js";

export const ofRun = true, needsEstimate = true;
const NORMALS = ["z", "y", "x"], STEPS = 40, SOON_MS = 120;
const chosen = { normal: "z", at: { x: null, y: null, z: null }, place: null };

export async function parts({ run }) {
  const body = make("div", { className: "field" });
  const show = async () => {
    const { normal, at } = chosen, where = at[normal] === null ? "" : `&at=${at[normal]}`;
    const plane = await read(`/api/page/runs/${encodeURIComponent(run)}/plane?normal=${normal}${where}`);
    if (normal === chosen.normal && at[normal] === chosen.at[normal]) fill(body, plane, show);
  };
  await show();
  return [heading("map.title"), body];
}

function fill(body, plane, show) {
  const focused = body.contains(document.activeElement) ? document.activeElement.id : "";
  const named = (name) => say(`field.plane_${name}`);
  const planes = choice("field.choose", NORMALS.map((name) => [name, `field.plane_${name}`]), chosen.normal, (name) => {
    Object.assign(chosen, { normal: name, place: null });
    return show();
  });
  planes.querySelectorAll("button").forEach((button, i) => (button.id = `plane-${NORMALS[i]}`));
  body.replaceChildren(
    facts([["map.before", um(plane.before)], ["map.after", um(plane.after)]]),
    make("div", { className: "choosers", role: "group", ariaLabel: named(chosen.normal) }, planes, slider(plane, show)),
    ...maps(plane),
    remark("field.is", { near: number(nearOf(plane), 0), axis: plane.normal }),
    ...(plane.with_um === null ? [remark("field.no_table")] : []),
  );
  if (focused) document.getElementById(focused)?.focus();
}

/* The third coordinate. The planes between two requests are left out. */
function slider(plane, show) {
  const [low, high] = plane.ranges_mm[plane.normal], key = plane.normal.toLowerCase();
  const told = (at) => say("field.at", { axis: plane.normal, at: number(at, 0) });
  const words = make("span", {}, told(plane.at_mm));
  const input = make("input", { type: "range", id: "plane-at", min: low, max: high, step: (high - low) / STEPS, value: plane.at_mm });
  input.setAttribute("aria-valuetext", told(plane.at_mm));
  let waiting = null;
  input.addEventListener("input", () => {
    chosen.at[key] = Number(input.value);
    words.textContent = told(chosen.at[key]);
    input.setAttribute("aria-valuetext", words.textContent);
    clearTimeout(waiting);
    waiting = setTimeout(() => show().catch(showProblem), SOON_MS);
  });
  return make("label", { className: "slider" }, words, input);
}

function maps(plane) {
  const { without_um: without, with_um: left, sigma_um: sigma, largest_um: top } = plane;
  const lengths = (vectors) => vectors.map((row, j) => row.map((vector, i) => lengthOf(vector, sigma[j][i])));
  const values = make("p", { className: "values", id: "values", role: "status" }, say("field.point"));
  const shown = [["without", lengths(without)], ...(left === null ? [] : [["with", lengths(left)]]), ["sigma", sigma]];
  const made = shown.map(([name, rows]) => new FieldMap(say(`field.${name}`), plane, rows, top, (column, row) => point([column, row])));
  const point = (place) => {
    chosen.place = place;
    for (const map of made) map.mark(place);
    values.replaceChildren(...valuesAt(plane, place));
  };
  if (chosen.place) point(chosen.place);
  return [values, make("div", { className: "planes" }, ...made.map(({ figure }) => figure)), scale(top)];
}

/* Values at a place in words: the coordinates, then each map with its components. */
function valuesAt(plane, [column, row]) {
  const { without_um: without, with_um: left, sigma_um: sigma, across: [a, b], ranges_mm: ranges, normal } = plane;
  const at = (axis, index, count) => ranges[axis][0] + (index / (count - 1)) * (ranges[axis][1] - ranges[axis][0]);
  const places = { [a]: at(a, column, without[0].length), [b]: at(b, row, without.length), [normal]: plane.at_mm };
  const doubt = sigma[row][column];
  const of = (name, vectors) => {
    const vector = vectors[row][column], [x, y, z] = vector.map((value) => number(value, 1));
    return make("span", {}, make("b", {}, say(`field.${name}_short`)), " ", say("field.value", { length: number(lengthOf(vector, doubt), 1), x, y, z }));
  };
  return [
    make("span", {}, say("field.place", Object.fromEntries(["X", "Y", "Z"].map((axis) => [axis.toLowerCase(), number(places[axis], 0)])))),
    of("without", without),
    left === null ? null : of("with", left),
    make("span", {}, make("b", {}, say("field.sigma_short")), " ", say("unit.um", { value: number(doubt, 1) })),
  ].filter(Boolean);
}

const um = ({ value_um, standard_uncertainty_um, limits_um }) =>
  limits_um ? say("unit.um_limits", { value: number(value_um, 1), lower: number(limits_um[0], 1), upper: number(limits_um[1], 1) }) :
  say(standard_uncertainty_um === null ? "unit.um" : "unit.um_sigma", { value: number(value_um, 1), sigma: number(standard_uncertainty_um, 1) });
