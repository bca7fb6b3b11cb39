/* Elements shared by the sections of the engineer view. */
import { make } from "./dom.js";
import { instant, known, number, say } from "./language.js";
import { verdictWord } from "./wording.js";

export function table(heads, rows, kind = "") {
  return make("div", { className: "scroll", role: "group", tabIndex: 0, ariaLabel: say("table.rows") }, make("table", { className: `data ${kind}` },
    make("thead", {}, make("tr", {}, ...heads.map((head) => make("th", { scope: "col" }, head)))),
    make("tbody", {}, ...rows.map((cells) => make("tr", {}, ...cells.map((cell) => make("td", {}, cell)))))));
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

/* Status of a table as a coloured mark: staged, active and accepted are always distinguishable. */
export const mark = (kind) => make("span", { className: `mark ${kind}` }, say(`table.${kind}`));

export const runName = ({ kind, started, verdict }) => `${instant(started)} · ${wordOr("kind", kind)} · ${verdict.sign} ${verdictWord(verdict)}`;

/* Figures of a run, the same in the list of runs and in the card of its end. */
export const micrometres = (value) => (value === null || value === undefined ? "–" : say("unit.um", { value: number(value, 2) }));
export const beforeAfter = (before, after) => (before === null ? "–" : after === null ? micrometres(before) : `${number(before, 2)} → ${micrometres(after)}`);
