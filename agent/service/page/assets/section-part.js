/* Section with the predicted errors of a part: its feature file and its place, what may be said about each tolerance, and a
   map of the places on the table. */
import { make } from "./dom.js";
import { number, say } from "./language.js";
import { choice, facts, field, heading, remark, table } from "./parts.js";
import { scale } from "./plane-map.js";
import { ask, Refused } from "./requests.js";
import { told } from "./sentences.js";
import { colourOf } from "./viridis.js";

export const ofRun = true, needsEstimate = true;
const AXES = ["x", "y", "z"], CELL = 40, PASTED = "CSV";
/* Kinds that cannot be negative: limits instead of U. */
const RANGES = new Set(["position", "flatness"]);
const wanted = { file: PASTED, text: "", best: false, at: { x: "", y: "", z: "" }, turned: "0" };
let last = null;

export async function parts({ run }) {
  const found = make("div", { className: "found", role: "status" });
  const predict = async () => {
    const wrong = typed().find(([, text]) => Number.isNaN(decimal(text)));
    if (wrong) {
      found.replaceChildren(complaint({ detail: say("part.no_number", { name: say(`part.${wrong[0]}`), text: wrong[1] }) }));
      document.getElementById(`part-${wrong[0]}`).focus();
      return;
    }
    found.replaceChildren(make("p", { className: "remark busy" }, say("section.loading")));
    try {
      last = { run, prediction: await ask(`/api/page/runs/${encodeURIComponent(run)}/part`, body()) };
      for (const [axis, at] of last.prediction.origin_mm.entries()) place(axis, at);
    } catch (error) {
      if (!(error instanceof Refused)) throw error;
      last = null;
      found.replaceChildren(complaint(error.problem));
      return;
    }
    show(found, predict);
  };
  if (last?.run === run) show(found, predict);
  return [heading("part.title"), remark("part.is"), form(predict), found];
}

const body = () => ({
  file: wanted.file, features: wanted.text, turned_deg: decimal(wanted.turned),
  ...(wanted.best ? { height_mm: decimal(wanted.at.z) } : { origin_mm: AXES.map((axis) => decimal(wanted.at[axis])) }),
});

/* The numbers that the prediction needs, as they are typed. */
const typed = () => [...(wanted.best ? ["z"] : AXES).map((axis) => [axis, wanted.at[axis]]), ["turned", wanted.turned]];

/* A number with a comma or a point; otherwise NaN. */
const decimal = (text) => (text.trim() === "" ? Number.NaN : Number(text.replace(",", ".")));

function place(axis, at) {
  wanted.at[AXES[axis]] = String(Math.round(10 * at) / 10);
  const input = document.getElementById(`part-${AXES[axis]}`);
  if (input) input.value = wanted.at[AXES[axis]];
}

function form(predict) {
  const text = make("textarea", { id: "part-text", rows: 8, spellcheck: false, placeholder: say("part.example"), value: wanted.text, oninput: () => (wanted.text = text.value) });
  const file = make("input", { type: "file", id: "part-file", accept: ".csv,text/csv", onchange: async () => {
    const [chosen] = file.files;
    if (!chosen) return;
    Object.assign(wanted, { file: chosen.name, text: await chosen.text() });
    text.value = wanted.text;
  } });
  const entry = (id, key, get, set, disabled = false) => {
    const input = make("input", { id: `part-${id}`, inputMode: "decimal", autocomplete: "off", size: 7, value: get(), disabled, oninput: () => set(input.value) });
    return field(key, input);
  };
  const coordinates = make("div", { className: "choosers" });
  const fill = () => coordinates.replaceChildren(
    choice("part.where", [[false, "part.stated"], [true, "part.best"]], wanted.best, (best) => {
      wanted.best = best;
      fill();
    }),
    ...AXES.map((axis) => entry(axis, `part.${axis}`, () => wanted.at[axis], (value) => (wanted.at[axis] = value), wanted.best && axis !== "z")),
    entry("turned", "part.turned", () => wanted.turned, (value) => (wanted.turned = value)),
  );
  fill();
  const send = (event) => {
    event.preventDefault();
    return predict();
  };
  return make("form", { className: "part", onsubmit: send }, make("div", { className: "choosers" }, field("part.file", file)), field("part.text", text), coordinates,
    make("div", { className: "acts" }, make("button", { id: "part-predict", type: "submit" }, say("part.predict"))));
}

function complaint({ detail, hint, where = {} }) {
  const places = Object.entries(where).filter(([kind]) => kind === "row" || kind === "column").map(([kind, at]) => say(`part.${kind}`, { at }));
  return make("section", { className: "card" }, make("p", {}, [told(detail), ...places].join(" · ")), hint ? make("p", { className: "remark" }, told(hint)) : null);
}

function show(found, predict) {
  const { features, places, origin_mm: [x, y, z], turned_deg: turned, table: role } = last.prediction;
  const states = ["without_table", ...(role === null ? [] : ["with_table"])];
  const heads = ["part.feature", "part.kind", "part.tolerance", ...states.flatMap((state) => [`part.${state}`, "part.answer"])];
  found.replaceChildren(
    facts([["part.place", say("part.at", { x: number(x, 1), y: number(y, 1), z: number(z, 1), turned: number(turned, 1) })],
      ["part.table", say(role === null ? "part.no_table" : `part.table_${role}`)]]),
    table(heads.map((key) => say(key)), features.map((one) => [one.name, say(`part.kind_${one.kind}`), limits(one), ...states.flatMap((state) => [error(one.kind, one[state]), answer(one[state])])])),
    remark("part.rule"), remark("part.only_geometry"),
    make("h3", {}, say("part.map")), placeMap(places, [x, y], predict),
  );
}

function limits({ lower_um: lower, upper_um: upper }) {
  if (lower === null && upper === null) return "–";
  const micrometres = (value) => say("unit.um", { value: number(value, 1) });
  if (lower === null) return `≤ ${micrometres(upper)}`;
  return upper === null ? `≥ ${micrometres(lower)}` : say("part.between", { lower: number(lower, 1), upper: number(upper, 1) });
}

const error = (kind, { expected_um: expected, expanded_um: expanded, low_um: low, high_um: high }) =>
  RANGES.has(kind) ? say("part.range", { value: number(expected, 1), lower: number(low, 1), upper: number(high, 1) }) : say("part.expanded", { value: number(expected, 1), expanded: number(expanded, 1) });

const word = (conformity) => conformity.replaceAll(" ", "_");
const answer = ({ conformity }) => make("span", { className: `mark ${word(conformity)}` }, say(`part.${word(conformity)}`));

/* Places that can be chosen: a click predicts the part there. */
function placeMap({ x_mm: xs, y_mm: ys, largest, unit, best_mm: best }, [x, y], predict) {
  const share = unit !== "µm", top = Math.max(...largest.flat()) || 1;
  const canvas = make("canvas", { width: CELL * xs.length, height: CELL * ys.length, role: "img", id: "part-map" });
  const context = canvas.getContext("2d");
  const text = (value) => (share ? say("unit.percent", { value: number(100 * value, 0) }) : say("unit.um", { value: number(value, 1) }));
  canvas.setAttribute("aria-label", say("part.map_name", { least: text(Math.min(...largest.flat())), most: text(top) }));
  xs.forEach((_, i) => ys.forEach((__, j) => {
    context.fillStyle = `rgb(${colourOf(largest[i][j] / top).join(" ")})`;
    context.fillRect(CELL * i, CELL * (ys.length - 1 - j), CELL, CELL);
  }));
  const middle = (list, at) => (list.length === 1 ? 0.5 : (at - list[0]) / (list.at(-1) - list[0]) * (list.length - 1) + 0.5);
  const at = ([u, v]) => [CELL * middle(xs, u), canvas.height - CELL * middle(ys, v)];
  sign(context, at(best), "★");
  if (Math.hypot(x - best[0], y - best[1]) > 0.1) sign(context, at([x, y]), "●");
  canvas.addEventListener("click", (event) => {
    const { left, top: above, width, height } = canvas.getBoundingClientRect();
    const nearest = (list, part) => list[Math.min(Math.floor(list.length * part), list.length - 1)];
    place(0, nearest(xs, (event.clientX - left) / width));
    place(1, nearest(ys, 1 - (event.clientY - above) / height));
    wanted.best = false;
    return predict();
  });
  const ends = (axis, list) => say(axis === "x" ? "map.x" : "map.y", { from: number(list[0], 0), to: number(list.at(-1), 0) });
  return make("figure", { className: "places" }, canvas, make("div", { className: "ends" }, make("span", {}, ends("x", xs)), make("span", {}, ends("y", ys))),
    scale(top, text), make("figcaption", { className: "remark" }, say(share ? "part.map_share" : "part.map_um")));
}

function sign(context, [x, y], text) {
  context.font = `${0.7 * CELL}px sans-serif`;
  context.textAlign = "center";
  context.textBaseline = "middle";
  context.lineWidth = 4;
  context.strokeStyle = "#000";
  context.strokeText(text, x, y);
  context.fillStyle = "#fff";
  context.fillText(text, x, y);
}
