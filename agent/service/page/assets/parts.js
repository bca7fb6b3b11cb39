/* Elements shared by the sections of the engineer view. */
import { make } from "./dom.js";
import { instant, known, number, say } from "./language.js";
import { verdictWord } from "./wording.js";

export function table(heads, rows, kind = "") {
  return make("div", { className: "scroll", role: "group", tabIndex: 0, ariaLabel: say("table.rows") }, make("table", { className: `data ${kind}` },
    make("thead", {}, make("tr", {}, ...heads.map((head) => make("th", { scope: "col" }, head)))),
    make("tbody", {}, ...rows.map((cells) => make("tr", {}, ...cells.map((cell, i) => cellOf(cell, heads[i])))))));
}

/* On a phone, each cell stands in a line of its own behind the name of its column. */
function cellOf(content, head) {
  const cell = make("td", {}, make("div", {}, content));
  cell.dataset.head = head;
  return cell;
}

export const heading = (key) => make("h2", {}, say(key));
export const remark = (key, values) => make("p", { className: "remark" }, say(key, values));

export function facts(pairs) {
  return make("dl", { className: "facts wide" }, ...pairs.map(([key, text]) => make("div", {}, make("dt", {}, say(key)), make("dd", {}, text))));
}

/* Choice of one option; `chosen` is called with its value. */
export function choice(name, options, value, chosen) {
  return make("div", { className: "choice", role: "group", ariaLabel: say(name) }, ...options.map(([option, key]) =>
    make("button", { ariaPressed: String(option === value), onclick: () => chosen(option) }, say(key))));
}

export const wordOr = (prefix, value) => (known(`${prefix}.${value}`) ? say(`${prefix}.${value}`) : String(value));

/* Control with its name above it. */
export const field = (key, control) => make("label", {}, say(key), control);

/* Pages of a list of `total` rows; `go` is called with the offset of another page. */
export function pager(offset, size, total, go) {
  const step = (to, key, possible) => make("button", { id: `page-${key}`, disabled: !possible, ariaLabel: say(`pager.${key}`), title: say(`pager.${key}`), onclick: () => go(to) }, SIGNS[key]);
  const last = Math.max(Math.ceil(total / size) - 1, 0) * size;
  if (!total || (!offset && total <= size)) return make("div", { className: "pager" });
  return make("div", { className: "pager" }, step(0, "first", offset > 0), step(Math.max(offset - size, 0), "former", offset > 0),
    make("span", {}, say("pager.place", { from: number(offset + 1, 0), to: number(Math.min(offset + size, total), 0), total: number(total, 0) })),
    step(offset + size, "next", offset + size < total), step(last, "last", offset < last));
}
const SIGNS = { first: "«", former: "‹", next: "›", last: "»" };

/* Status of a table as a coloured mark: staged, active and accepted are always distinguishable. */
export const mark = (kind) => make("span", { className: `mark ${kind}` }, say(`table.${kind}`));

export const runName = ({ kind, started, verdict }) => `${instant(started)} · ${wordOr("kind", kind)} · ${verdict.sign} ${verdictWord(verdict)}`;

/* Figures of a run, the same in the list of runs and in the card of its end. */
export const micrometres = (value) => (value === null || value === undefined ? "–" : say("unit.um", { value: number(value, 2) }));
export const beforeAfter = (before, after) => (before === null ? "–" : after === null ? micrometres(before) : `${number(before, 2)} → ${micrometres(after)}`);

/* Difference of two compensation tables, axis by axis. */
export function tableDifference({ same, axes }) {
  if (same) return remark("tables.same");
  return table(["tables.axis", "tables.largest", "tables.at", "tables.rms"].map((key) => say(key)), axes.map(({ axis, largest_um, at_mm, rms_um }) =>
    [axis, say("unit.um", { value: number(largest_um, 2) }), at_mm.map((value) => number(value, 0)).join(" / "), say("unit.um", { value: number(rms_um, 2) })]), "compact");
}
